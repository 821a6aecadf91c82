"""Control points: spots in the world that are clicked in photos and whose positions on the map are known.

A control point is triangulated in the world of a submodel from the rays of its clicks; a click that disagrees
with the others is left out. It then aligns the submodel with the map as a placed photo does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.submodels import Submodel

Array = NDArray[np.float64]

CLICK_RAD = np.radians(0.15)
"""Standard deviation of a click's ray, camera pose included: two pixels of a photo 1000 pixels wide."""

_AGREE_RAD = 4.0 * CLICK_RAD
"""A click is wrong if its ray misses the point by more than this angle."""

_LEAST_ANGLE_RAD = np.radians(1.5)
"""Least angle between the rays of a point: below it, the distance is too uncertain."""

_ROUNDS = 5

_MOST_PAIRS = 500
"""Largest number of pairs of clicks that propose a point."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownPoint:
    """A control point; m clicks."""

    name: str
    at: complex  # Map pixels, x + iy
    sigma_px: float  # Standard deviation along both axes, map pixels
    height_px: float  # Above any reference level common to all points, map pixels; NaN where unknown
    photo: NDArray[np.int64]  # (m,) int64. Numbers of the pictures that show it, as in `Submodel.photo`.
    shown_by: tuple[str, ...]  # Names of these pictures; the views of a panorama share one name
    ray: Array  # (m, 3) float64. Unit vectors to it in the frames of their cameras: right, down, front.
    is_check: bool = False  # Left out of the fit; see `GroundControlPoint`


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """A control point in the world of a submodel."""

    point: KnownPoint
    at: Array  # (3,) float64
    covariance: Array  # (3, 3) float64
    row: NDArray[np.int64]  # (r,) int64. Rows of the submodel's photos whose clicks agree.
    wrong: tuple[str, ...]  # Names of the photos whose clicks disagree


@dataclass(frozen=True, slots=True)
class NotTriangulated:
    """A control point that could not be triangulated in a submodel, and the reason. Falsy."""

    point: KnownPoint
    reason: str
    clicks: int  # Number of photos of the submodel in which it is clicked

    def __bool__(self) -> bool:
        return False


class _Rays(NamedTuple):
    """Origins (r, 3) and unit direction vectors (r, 3) of rays."""

    centre: Array
    direction: Array

    def subset(self, rows: Sequence[int] | NDArray[np.int64]) -> _Rays:
        return _Rays(self.centre[rows], self.direction[rows])

    def angles(self, at: Array) -> Array:
        """Return the angles (r,), radians, by which the rays miss a point."""
        to = at - self.centre
        along = np.einsum("rk,rk->r", to, self.direction)
        across = np.linalg.norm(to - along[:, None] * self.direction, axis=1)
        off: Array = np.arctan2(across, along)
        return off

    def information(self, at: Array) -> tuple[Array, Array]:
        """Return the normal equations of a point, (3, 3) and (3,), for errors `CLICK_RAD`, seen at `at`."""
        away = np.maximum(np.linalg.norm(at - self.centre, axis=1), 1e-12)
        across = np.eye(3) - self.direction[:, :, None] * self.direction[:, None, :]
        across = across / (away * CLICK_RAD)[:, None, None] ** 2
        return np.asarray(across.sum(0)), np.einsum("rij,rj->i", across, self.centre)

    def widest(self) -> float:
        """Return the largest angle between two rays, radians."""
        cosine = np.clip(self.direction @ self.direction.T, -1.0, 1.0)
        return float(np.arccos(cosine.min()))


def triangulate(point: KnownPoint, submodel: Submodel) -> Triangulated | NotTriangulated:
    row_of = {photo: row for row, photo in enumerate(submodel.photo.tolist())}
    clicked: dict[str, tuple[int, int]] = {}
    for number, photo in enumerate(point.photo.tolist()):
        if photo in row_of:
            clicked.setdefault(point.shown_by[number], (row_of[photo], number))
    names = [*clicked]
    if len(names) < 2:
        where = (
            f"is clicked in one joined photo only, {names[0]}"
            if names
            else "is not clicked in any joined photo"
        )
        return NotTriangulated(point, f"{where}: click it in two or more", len(names))
    row, click = (np.array(some, np.int64) for some in zip(*clicked.values(), strict=True))
    rays = _Rays(submodel.centre[row], np.einsum("rji,rj->ri", submodel.rotation[row], point.ray[click]))
    best = _agreeing(rays)
    if best is None:
        if rays.widest() < _LEAST_ANGLE_RAD:
            reason = f"{_listed(names)} show it from nearly the same direction: click it in one from the side"
        else:
            reason = f"the clicks in {_listed(names)} contradict each other"
        return NotTriangulated(point, reason, len(names))
    at, good = best
    wrong = tuple(name for number, name in enumerate(names) if number not in good)
    information, _ = rays.subset(good).information(at)
    return Triangulated(point, at, np.asarray(np.linalg.inv(information), np.float64), row[good], wrong)


def sigma_by_points(submodel: Submodel, points: Sequence[KnownPoint]) -> Array:
    """Compute how accurately control points locate the n photos of a submodel.

    The information of a point is divided equally among the photos that show it, so that it counts once.

    Args:
        submodel: In the world of the map: x and y are map pixels.

    Returns:
        (n,) float64: Standard deviations along both axes, map pixels; infinite for photos that show none.
    """
    information = np.zeros(len(submodel))
    for point in points:
        found = triangulate(point, submodel)
        if isinstance(found, Triangulated):
            variance = point.sigma_px**2 + np.trace(found.covariance[:2, :2]) / 2.0
            information[found.row] += 1.0 / (variance * len(found.row))
    with np.errstate(divide="ignore"):
        return np.asarray(information**-0.5)


def _agreeing(rays: _Rays) -> tuple[Array, NDArray[np.int64]] | None:
    """Find the point on which most rays agree, and these rays; None if no two agree, or at a tie."""
    found: dict[tuple[int, ...], Array] = {}
    pairs = [*combinations(range(len(rays.centre)), 2)]
    for pair in pairs[:: -(-len(pairs) // _MOST_PAIRS)]:
        some = rays.subset([*pair])
        if some.widest() < _LEAST_ANGLE_RAD:
            continue
        at = _nearest(some)
        for _ in range(_ROUNDS):
            good = np.flatnonzero(rays.angles(at) < _AGREE_RAD)
            if len(good) < 2:
                break
            at = _nearest(rays.subset(good), near=at)
        if set(pair) <= set(good.tolist()):
            found[tuple(good.tolist())] = at
    most = max((len(good) for good in found), default=0)
    largest = [good for good in found if len(good) == most]
    return (found[largest[0]], np.array(largest[0], np.int64)) if len(largest) == 1 else None


def _nearest(rays: _Rays, near: Array | None = None) -> Array:
    """Find the point nearest to rays by weighted least squares; the weights are those of angles at `near`."""
    start: Array = np.asarray(rays.centre.mean(0) + rays.direction.mean(0)) if near is None else near
    matrix, vector = rays.information(start)
    return np.asarray(np.linalg.solve(matrix, vector), np.float64)


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
