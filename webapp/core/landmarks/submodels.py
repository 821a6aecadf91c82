"""Submodels of a reconstruction, their plan views, and similarities between point sets.

A reconstruction is split where its photos share too few points: a part that is connected by a few points
only, at a sharp turn or between similar facades, has an arbitrary direction and scale. It becomes a submodel
of its own, which is aligned with the map separately.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.robust import geman_mcclure

Array = NDArray[np.float64]

_FLAT = 1e-9
"""Fraction of the largest singular value below which another one counts as zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """Maps x to `scale * rotation @ x + shift`."""

    scale: float
    rotation: Array  # (d, d) float64. Proper, never a reflection.
    shift: Array  # (d,) float64

    def apply(self, points: Array) -> Array:
        """Map (n, d) points."""
        moved: Array = self.scale * points @ self.rotation.T + self.shift
        return moved


@dataclass(frozen=True, slots=True)
class NoSimilarity:
    """The points do not determine a similarity, and the reason. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def fit_similarity(source: Array, target: Array, *, weight: Array | None = None) -> Similarity | NoSimilarity:
    """Fit a similarity by least squares.

    Args:
        source, target: (n, d) float64
        weight: (n,) float64. At least 0; by default all count the same.
    """
    dimensions = source.shape[1]
    share = np.full(len(source), 1.0) if weight is None else weight
    if np.count_nonzero(share) < dimensions:
        return NoSimilarity(f"fewer than {dimensions} points")
    share = share / share.sum()
    middle, goal = share @ source, share @ target
    off, wanted = source - middle, target - goal
    covariance = (share[:, None] * wanted).T @ off
    left, spread, right = np.linalg.svd(covariance)
    # two points suffice in the plane, three not on a line in space: the last singular value may be zero
    needed = dimensions - 2
    if spread[0] <= 0.0 or spread[needed] <= _FLAT * spread[0]:
        return NoSimilarity("the points are at one spot" if dimensions == 2 else "the points are in a line")
    signs = np.ones(dimensions)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotation = left @ (signs[:, None] * right)
    scale = float((spread * signs).sum() / (share @ (off**2).sum(1)))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)


Points = NDArray[np.complex128]

_PITCH_COUNTS = 0.1
"""Weight of the cameras' down axes: a camera rolls by a few degrees only, but pitches more freely."""

_TILT_SIGMA, _ROUNDS = 0.15, 10
_MOST_TILT = 0.35
"""Median sine between the cameras' right axes and the level plane above which they share no vertical."""


_UPRIGHT = 0.5
"""See `_towards_ground`: from this value on cameras are upright, below its negative upside down."""

_PLANAR, _WIDE = 0.3, 0.15
"""Cameras are in a plane if its thickness is at most this fraction of its width, and its width at least this
fraction of its length (singular values of the centres)."""

_LEAST_WIDE = 0.05
"""Ratio of the second to the first singular value of points below which they do not fix the vertical."""

_MOST_MISFIT = 0.1
"""RMS error of points, as a fraction of their extent, above which their heights do not fit."""

_MUCH_BETTER = 5.0
"""Factor by which the error must fall without one of the points for that one to be wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class Submodel:
    """n photos with relative poses from structure from motion."""

    photo: NDArray[np.int64]  # (n,) int64. Numbers of the photos.
    centre: Array  # (n, 3) float64. Camera centres, in the world of the submodel.
    rotation: Array  # (n, 3, 3) float64. Camera from world.
    # Lower limit of the error over the distance to the nearest placed photo, measured before the submodel was
    # adjusted by known positions; 0 if there is none.
    error_rate: float = 0.0
    # (n, 2, 2) float64 or None. Of the positions on the map, map pixels squared; only for a submodel that was
    # adjusted by known positions, whose world is that of the map: see `position_covariances`.
    covariance: Array | None = None
    # (n, 3) float64 or None. Where adjustments without a placed photo put it, x and y in map pixels, and its
    # standard deviation there over their median; NaN where not measured. None if positions were not left out.
    left_out: Array | None = None

    def __len__(self) -> int:
        return len(self.photo)


def view_rotation(turn_deg: float) -> Array:
    """Compute the (3, 3) rotation from the middle of a panorama to a level view turned clockwise from it."""
    sine, cosine = np.sin(np.radians(turn_deg)), np.cos(np.radians(turn_deg))
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


def of_photos(submodel: Submodel, *, photo: NDArray[np.int64], turn_deg: NDArray[np.int64]) -> Submodel:
    """Merge the views of each panorama of a submodel into one camera that looks towards its middle.

    Args:
        photo: (n,) int64. Number of the photo of each picture of the submodel.
        turn_deg: (n,) int64. Clockwise turn of each picture from the middle of its panorama; 0 for a photo
            that is not a panorama.
    """
    first = np.sort(np.unique(photo, return_index=True)[1])
    middle = np.array([view_rotation(turn_deg[row]).T @ submodel.rotation[row] for row in first])
    return Submodel(
        photo[first],
        submodel.centre[first],
        middle.reshape(-1, 3, 3),
        submodel.error_rate,
        None if submodel.covariance is None else submodel.covariance[first],
        None if submodel.left_out is None else submodel.left_out[first],
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlanView:
    """A submodel seen from above; positions are complex numbers, x to the right and y down as in an image."""

    position: Points  # (n,) complex128. In an arbitrary frame and unit.
    forward: Points  # (n,) complex128. Viewing direction of each camera; not of unit length.
    # (3, 3) float64. Proper rotation from the world of the submodel: its first row is the x of the view, the
    # second its y, and the third points down.
    frame: Array


def view_by_level_cameras(submodel: Submodel) -> PlanView | None:
    """Project a submodel along the common vertical of its cameras; None if they share none.

    The vertical is the direction most perpendicular to the cameras' right axes and closest to their down
    axes; the latter determine it where all cameras look the same way.
    """
    right, down = submodel.rotation[:, 0], submodel.rotation[:, 1]
    weight, lowest = np.ones(len(submodel)), np.zeros(3)
    for _ in range(_ROUNDS):
        wanted = (weight[:, None] * right).T @ right - _PITCH_COUNTS * (weight[:, None] * down).T @ down
        lowest = np.linalg.eigh(wanted)[1][:, 0]
        lowest = lowest * np.sign((weight[:, None] * down).sum(0) @ lowest or 1.0)
        upright = down @ lowest > 0.0
        weight = np.where(upright, geman_mcclure((right @ lowest) ** 2, _TILT_SIGMA), 1e-6)
    if np.median(np.where(down @ lowest > 0.0, np.abs(right @ lowest), 1.0)) > _MOST_TILT:
        return None
    return _seen_along(submodel, lowest)


def view_of_map(submodel: Submodel) -> PlanView | None:
    """View a submodel along the z axis of the map; None if its world is not that of the map."""
    return None if submodel.covariance is None else _seen_along(submodel, np.array([0.0, 0.0, 1.0]))


def view_by_plane(submodel: Submodel) -> PlanView | None:
    """Project a submodel onto the plane in which its cameras are; None if they are on a line or in no plane.

    As cameras look towards the ground rather than the sky, their front and down axes show the side that is
    up.
    """
    off = submodel.centre - submodel.centre.mean(0)
    _, along, axes = np.linalg.svd(off, full_matrices=True)
    if len(along) < 3 or along[1] < _WIDE * along[0] or along[2] > _PLANAR * along[1]:
        return None
    towards = _towards_ground(submodel, axes[2])
    if abs(towards) < _UPRIGHT:
        return None
    return _seen_along(submodel, np.sign(towards) * axes[2])


def _towards_ground(submodel: Submodel, down: Array) -> float:
    """Return the mean sine of the angle that front and down axes together are below the horizon.

    It is at least 1 for cameras that are level or look down, at any angle.
    """
    return float(((submodel.rotation[:, 1] + submodel.rotation[:, 2]) @ down).mean())


def view_by_positions(submodel: Submodel, *, known: NDArray[np.bool_], position: Points) -> PlanView | None:
    """Project a submodel along the vertical of a fit to known positions.

    None for fewer than three or a line, and if the cameras would be upside down.

    Args:
        known: (n,) bool
        position: (n,) complex128. Map pixels, of those that are known.
    """
    at = np.stack([position.real, np.zeros(len(position)), -position.imag], 1)
    fit = fit_similarity(submodel.centre[known], at[known])
    if not isinstance(fit, Similarity):
        return None
    if _towards_ground(submodel, fit.rotation[1]) < -_UPRIGHT:
        return None
    return _seen_along(submodel, fit.rotation[1])


def view_by_heights(submodel: Submodel, *, centre: Array, position: Points, height: Array) -> PlanView | None:
    """Project a submodel along the vertical of a fit to points of known heights; None if these do not fix it.

    That is if they are fewer than three, nearly on a line, or fit no similarity. Of four or more, one that
    contradicts all others is ignored.

    Args:
        centre: (n, 3) float64. In the world of the submodel.
        position: (n,) complex128. Map pixels.
        height: (n,) float64. Map pixels; NaN where unknown.
    """
    known = np.flatnonzero(np.isfinite(height))
    there = np.stack([position.real, -height, -position.imag], 1)
    fits = [_up_by(centre[known], there[known])]
    if len(known) > 3:
        fits += [
            _up_by(centre[kept], there[kept]) for kept in (np.delete(known, n) for n in range(len(known)))
        ]
    error, down = min(fits, key=lambda fit: fit[0] * (_MUCH_BETTER if fit is not fits[0] else 1.0))
    return _seen_along(submodel, down) if error < _MOST_MISFIT else None


def _up_by(centre: Array, there: Array) -> tuple[float, Array]:
    """Fit points to known positions; return the RMS error over their extent, and down in their own world."""
    extent = np.sqrt(((there - there.mean(0)) ** 2).sum(1).mean()) if len(there) > 2 else 0.0
    along = np.linalg.svd(centre - centre.mean(0), compute_uv=False) if len(there) > 2 else np.zeros(3)
    if extent <= 0.0 or along[1] < _LEAST_WIDE * along[0]:
        return np.inf, np.zeros(3)
    fit = fit_similarity(centre, there)
    if not isinstance(fit, Similarity):
        return np.inf, np.zeros(3)
    return float(np.sqrt(((fit.apply(centre) - there) ** 2).sum(1).mean()) / extent), fit.rotation[1]


def _seen_along(submodel: Submodel, down: Array) -> PlanView:
    """Project a submodel along a unit vector of its world that points down."""
    any_other = np.eye(3)[np.abs(down).argmin()]
    right = np.cross(down, any_other)
    right /= np.linalg.norm(right)
    # right-handed: x to the right and y down in the view from above, z down into the ground
    frame = np.stack([right, np.cross(down, right), down])
    position, front = submodel.centre @ frame[:2].T, submodel.rotation[:, 2] @ frame.T
    # a camera that looks straight down or up is directed to where the top of its photo is, or the bottom
    steep = front[:, 2] * np.abs(front[:, 2])
    forward = front[:, :2] - steep[:, None] * (submodel.rotation[:, 1] @ frame[:2].T)
    return PlanView(position @ np.array([1, 1j]), forward @ np.array([1, 1j]), frame)


LEAST_PHOTOS = 3
"""Least number of photos of a submodel."""

_LEAST_SHARED = 20
"""Least number of shared points that connect two photos rigidly."""


def rigid_parts(
    shared: NDArray[np.int32], *, frame: NDArray[np.int64] | None = None
) -> list[NDArray[np.int64]]:
    """Split photos into rigidly connected parts, the largest first; smaller ones are left out.

    Args:
        shared: (n, n) int32. Number of points that two photos share.
        frame: (n,) int64. Photos with the same frame, views of a panorama, are always connected and count as
            one photo. By default each photo has its own.
    """
    own = np.arange(len(shared)) if frame is None else frame
    strong = (shared >= _LEAST_SHARED) | (own[:, None] == own)
    part = np.full(len(shared), -1, np.int64)
    for seed in range(len(shared)):
        if part[seed] >= 0:
            continue
        inside = np.zeros(len(shared), np.bool_)
        inside[seed] = True
        border = inside
        while border.any():
            border = strong[border].any(0) & ~inside
            inside |= border
        part[inside] = seed
    parts = [np.flatnonzero(part == seed) for seed in np.unique(part)]
    enough = (p for p in parts if len(np.unique(own[p])) >= LEAST_PHOTOS)
    return sorted(enough, key=len, reverse=True)
