"""Position and heading from all matches with photos whose orientations are known.

Each verified photo, with its relative pose, says how the query was held and on which line through the photo
it was taken. Points along these lines are starting points; each is judged by how many matches, of all photos,
lie on their epipolar lines, and the best are refined by all matches at once (structure-less: no 3D points).
The camera is held about level; its height is about that of the map's cameras.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.relative import RelativePose
from webapp.core.reconstruction import so3
from webapp.core.reconstruction.types import USABLE_TRUST, Orientations

Array = NDArray[np.float64]

_DISTANCES = (0.15, 0.5, 1.0, 2.0)
"""Starting points on the line through a photo, in place radii from it."""

_LEAST_TRUST = 0.15
_STARTS = 4
"""So many starting points are refined."""

_STARTS_APART = 0.3
"""Starting points nearer to each other, in place radii, are one."""

_NOISE = 2.0 / 450.0
"""Spread of a right match, at depth 1, orientations of the map's photos included."""

_TOLERANCE = 2.5 / 450.0
"""Up to here a match agrees; three times as far for starting points."""

_NEAR = 3.0
"""How fast a photo's say fades with its distance, in place radii."""

_BY_CHANCE, _MANY = 2.0, 20.0
"""Agreeing matches of a photo that mean nothing, and a scale for more of them."""

_ROLL_DEG = 6.0
_ROUNDS = 10
_WIDER, _NARROWING = 15.0, 0.65
_ROLL_SPREAD, _PITCH_SPREAD, _HEIGHT_SPREAD = 0.035, 0.35, 0.3
_MOST_TURN, _MOST_STEP = 0.2, 0.7
_PARALLEL = 1e-4
"""Squared sine of the angle between rays that are too parallel to tell front from behind."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A verified photo.

    Attributes
    ----------
    photo : int
        Its number in the map.
    pose : RelativePose
    query_ray, photo_ray : (m, 3) float64
        Of all its matches, camera frames, depth 1.
    """

    photo: int
    pose: RelativePose
    query_ray: Array
    photo_ray: Array


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A pose of the query that explains many matches.

    Attributes
    ----------
    x, y : float
        Map pixels.
    heading : float
        Radians clockwise from up.
    score : float
        About the number of photos that agree.
    covariance_px2 : (2, 2) float64
        Of (x, y), by the matches alone, as if they erred independently.
    agreement : (n,) float64
        Of each view, 0 to 1.
    """

    x: float
    y: float
    heading: float
    score: float
    covariance_px2: Array
    agreement: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """All matches with oriented photos; m of them.

    Attributes
    ----------
    query : (m, 3) float64
        Rays in the query's frame.
    photo : (m, 3) float64
        Rays of the map's photos in the world.
    centre : (m, 3) float64
        Where the photos were taken, world.
    view : (m,) int64
        Number of the view.
    views : int
    radius : float
        The place radius.
    """

    query: Array
    photo: Array
    centre: Array
    view: NDArray[np.int64]
    views: int
    radius: float


def locate(
    views: Sequence[View],
    position: Array,
    *,
    orientations: Orientations,
    place_radius_px: float,
) -> list[Pose]:
    """Find poses of the query.

    Parameters
    ----------
    views : sequence of View
        n verified photos.
    position : (p, 2) float64
        Of the map's photos, map pixels.
    orientations : Orientations
        Of the map's photos.
    place_radius_px : float

    Returns
    -------
    list of Pose
        The best first; empty when no photo with a known orientation was verified.
    """
    world = np.column_stack([position[:, 0], orientations.height, -position[:, 1]])
    usable = [n for n, v in enumerate(views) if orientations.trust[v.photo] >= USABLE_TRUST]
    rotation, centre = _starts(
        [views[n] for n in usable], world, orientations=orientations, radius=place_radius_px
    )
    if not len(rotation):
        return []
    scene = _scene(views, usable, world, orientations=orientations, radius=place_radius_px)
    score, _ = _judge(scene, rotation, centre, tolerance=3.0 * _TOLERANCE)
    chosen = _apart(centre, score, _STARTS_APART * place_radius_px)[:_STARTS]
    rotation, centre, information = _refine(scene, rotation[chosen], centre[chosen])
    score, agreement = _judge(scene, rotation, centre, tolerance=_TOLERANCE)
    heading = so3.heading(rotation)
    poses = [
        Pose(
            x=float(centre[i, 0]),
            y=float(-centre[i, 2]),
            heading=float(heading[i] % (2.0 * math.pi)),
            score=float(score[i]),
            covariance_px2=_covariance(information[i], place_radius_px),
            agreement=agreement[i],
        )
        for i in range(len(centre))
    ]
    return sorted(poses, key=lambda p: -p.score)


def _scene(
    views: Sequence[View], usable: list[int], world: Array, *, orientations: Orientations, radius: float
) -> _Scene:
    chosen = [views[n] for n in usable]
    lengths = [len(v.query_ray) for v in chosen]
    return _Scene(
        query=np.concatenate([v.query_ray for v in chosen]),
        photo=np.concatenate([v.photo_ray @ orientations.rotation[v.photo] for v in chosen]),
        centre=np.repeat(world[[v.photo for v in chosen]], lengths, axis=0),
        view=np.repeat(np.array(usable, np.int64), lengths),
        views=len(views),
        radius=radius,
    )


def _starts(
    views: Sequence[View], world: Array, *, orientations: Orientations, radius: float
) -> tuple[Array, Array]:
    """Give (s, 3, 3) rotations and (s, 3) centres to start from."""
    rotations, centres = [], []
    for view in views:
        if view.pose.trust < _LEAST_TRUST:
            continue
        photo = orientations.rotation[view.photo]
        to_query = photo.T @ view.pose.shift
        for distance in _DISTANCES:
            rotations.append(view.pose.rotation.T @ photo)
            centres.append(world[view.photo] + distance * radius * to_query)
    return np.array(rotations).reshape(-1, 3, 3), np.array(centres).reshape(-1, 3)


def _apart(centre: Array, score: Array, distance: float) -> list[int]:
    """Number the points by falling score, without those near a better one."""
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if all(np.linalg.norm(centre[i] - centre[k]) > distance for k in kept):
            kept.append(int(i))
    return kept


_Vectors = tuple[Array, Array, Array]
"""Vectors by their components, x, y and z, which is many times faster than one array (..., 3) of them."""


def _cross(u: _Vectors, v: _Vectors) -> _Vectors:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _dot(u: _Vectors, v: _Vectors) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Of m matches under s poses; all arrays are (s, m).

    Attributes
    ----------
    off : array
        Sampson's distance at depth 1.
    ahead : array
        1 where the matched point is in front of both cameras, or too far to tell; else 0.
    query, along : _Vectors
        The query's rays in the world; from the query to the photo, length 1.
    photo_along, query_photo : _Vectors
        Cross products of the photo's ray with `along`, and of both rays.
    length, size : array
        Distance of the photo; what makes `off` of the error of the epipolar constraint.
    """

    off: Array
    ahead: Array
    query: _Vectors
    along: _Vectors
    photo_along: _Vectors
    query_photo: _Vectors
    length: Array
    size: Array


def _residuals(scene: _Scene, rotation: Array, centre: Array) -> _Residuals:
    turned = np.swapaxes(rotation, 1, 2) @ scene.query.T
    a, b = (turned[:, 0], turned[:, 1], turned[:, 2]), tuple(scene.photo.T)
    x, y, z = (scene.centre[:, i] - centre[:, i, None] for i in range(3))
    length = np.sqrt(_dot((x, y, z), (x, y, z))) + 1e-9
    along = (x / length, y / length, z / length)
    b_along, along_a, a_b = _cross(b, along), _cross(along, a), _cross(a, b)
    in_query = [_dot(tuple(rotation[:, i].T[..., None]), b_along) for i in range(2)]
    # The photo's own image plane is not at hand; the whole vector differs little from its part in it.
    size = np.sqrt(in_query[0] ** 2 + in_query[1] ** 2 + _dot(along_a, along_a)) + 1e-9
    # The point lies where both rays meet; (along x b)(a x b) and (along x a)(a x b) are its depths' signs.
    ahead = (_dot(b_along, a_b) <= 0.0) & (_dot(along_a, a_b) >= 0.0) | (_dot(a_b, a_b) < _PARALLEL)
    off = _dot(a, b_along) / size
    return _Residuals(off, ahead.astype(np.float64), a, along, b_along, a_b, length, size)


def _derivatives(found: _Residuals, radius: float) -> Array:
    """Derivatives of `off` by a turn of the query in the world and its place in place radii; (s, 6, m)."""
    turn = _cross(found.query, found.photo_along)
    part = _dot(found.query_photo, found.along)
    across = (v - part * w for v, w in zip(found.query_photo, found.along, strict=True))
    by_place = -radius / (found.length * found.size)
    return np.stack([*(v / found.size for v in turn), *(v * by_place for v in across)], axis=1)


def _judge(scene: _Scene, rotation: Array, centre: Array, *, tolerance: float) -> tuple[Array, Array]:
    """Score s poses; returns (s,) scores and (s, n) agreements of the views."""
    found = _residuals(scene, rotation, centre)
    agrees = np.maximum(0.0, 1.0 - (found.off / tolerance) ** 2) * found.ahead
    distance = np.hypot(
        scene.centre[None, :, 0] - centre[:, None, 0], scene.centre[None, :, 2] - centre[:, None, 2]
    )
    agrees = agrees * np.exp(-distance / (_NEAR * scene.radius))
    counts = np.stack([np.bincount(scene.view, weights=row, minlength=scene.views) for row in agrees])
    agreement = 1.0 - np.exp(-np.maximum(counts - _BY_CHANCE, 0.0) / _MANY)
    roll = np.degrees(np.arcsin(np.clip(rotation[:, 0, 1], -1.0, 1.0)))
    return agreement.sum(1) / (1.0 + (roll / _ROLL_DEG) ** 2), agreement


def _refine(scene: _Scene, rotation: Array, centre: Array) -> tuple[Array, Array, Array]:
    """Refine s poses by all matches; returns rotations, centres, and (s, 6, 6) information (turn, step)."""
    level = float(np.median(scene.centre[:, 1]))
    for number in range(_ROUNDS):
        spread = _NOISE * max(1.0, _WIDER * _NARROWING**number)
        matrix, vector = _equations(scene, rotation, centre, spread=spread, level=level)
        step = so3.solved(matrix + 1e-3 * np.eye(6), vector)
        rotation = so3.turned(rotation, so3.shortened(step[:, :3], _MOST_TURN))
        centre = centre + so3.shortened(step[:, 3:], _MOST_STEP) * scene.radius
    return rotation, centre, _equations(scene, rotation, centre, spread=_NOISE, level=level)[0]


def _equations(
    scene: _Scene, rotation: Array, centre: Array, *, spread: float, level: float
) -> tuple[Array, Array]:
    """Normal equations of s poses: (s, 6, 6) and (s, 6), by turn and step.

    The camera is held about level, and about as high as the map's.
    """
    found = _residuals(scene, rotation, centre)
    strength = found.ahead / (1.0 + (found.off / spread) ** 2) ** 2 / spread**2
    derivatives = _derivatives(found, scene.radius)
    weighted = derivatives * strength[:, None]
    matrix = weighted @ np.swapaxes(derivatives, 1, 2)
    vector = -(weighted @ found.off[..., None])[..., 0]
    for (sine, row), tilt in zip(so3.tilts(rotation), (_ROLL_SPREAD, _PITCH_SPREAD), strict=True):
        matrix[:, :3, :3] += row[:, :, None] * row[:, None, :] / tilt**2
        vector[:, :3] -= row * sine[:, None] / tilt**2
    matrix[:, 4, 4] += 1.0 / _HEIGHT_SPREAD**2
    vector[:, 4] -= (centre[:, 1] - level) / scene.radius / _HEIGHT_SPREAD**2
    return matrix, vector


def _covariance(information: Array, radius: float) -> Array:
    """Covariance of (x, y), map pixels squared, from the information of turn and step."""
    whole = np.linalg.inv(information + 1e-9 * np.eye(6))[np.ix_([3, 5], [3, 5])] * radius**2
    flip = np.diag([1.0, -1.0])  # y is down the map, z is north
    covariance: Array = flip @ whole @ flip
    return covariance
