"""Control points: spots of the world that are clicked in photos and whose place on the map is known.

Where one is in the world of a submodel follows from the rays of its clicks; a click that disagrees with the
others is left out. It is then known as a placed photo is, and no photo has to be placed.
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
"""Standard deviation of a click with that of its photo's camera: two pixels of a photo 1000 pixels wide."""

_AGREE_RAD = 4.0 * CLICK_RAD
"""A click is wrong when its ray misses the point by more."""

_LEAST_ANGLE_RAD = np.radians(1.5)
"""Between the rays of a point, of which the distance would else be uncertain."""

_ROUNDS = 5

_MOST_PAIRS = 500
"""Pairs of clicks from which a point is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownPoint:
    """A control point; m clicks.

    Attributes
    ----------
    at : complex
        Map pixels, x + iy.
    sigma_px : float
        Standard deviation along both axes, map pixels.
    height_px : float
        Above any level that is the same for all, map pixels; NaN where unknown.
    photo : (m,) int64
        Numbers of the pictures that show it, as submodels have them.
    shown_by : tuple of str
        What these are called; the views of a panorama have one name.
    ray : (m, 3) float64
        Unit vectors to it in the frames of their cameras: right, down, front.
    """

    name: str
    at: complex
    sigma_px: float
    height_px: float
    photo: NDArray[np.int64]
    shown_by: tuple[str, ...]
    ray: Array


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """A control point in the world of a submodel.

    Attributes
    ----------
    at : (3,) float64
    covariance : (3, 3) float64
    row : (r,) int64
        Photos of the submodel whose clicks agree.
    wrong : tuple of str
        Photos in which it is clicked elsewhere.
    """

    point: KnownPoint
    at: Array
    covariance: Array
    row: NDArray[np.int64]
    wrong: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NotTriangulated:
    """It is not known where a control point is in the world of a submodel, and why. Falsy.

    Attributes
    ----------
    clicks : int
        In photos of the submodel.
    """

    point: KnownPoint
    reason: str
    clicks: int

    def __bool__(self) -> bool:
        """Return False: it is not known."""
        return False


class _Rays(NamedTuple):
    """From where, (r, 3), and to where, (r, 3) unit vectors."""

    centre: Array
    direction: Array

    def subset(self, rows: Sequence[int] | NDArray[np.int64]) -> _Rays:
        return _Rays(self.centre[rows], self.direction[rows])

    def angles(self, at: Array) -> Array:
        """Angles (r,) by which they miss a point, radians."""
        to = at - self.centre
        along = np.einsum("rk,rk->r", to, self.direction)
        across = np.linalg.norm(to - along[:, None] * self.direction, axis=1)
        off: Array = np.arctan2(across, along)
        return off

    def information(self, at: Array) -> tuple[Array, Array]:
        """Matrix (3, 3) and vector (3,) of the normal equations of a point, each ray as exact as an angle."""
        away = np.maximum(np.linalg.norm(at - self.centre, axis=1), 1e-12)
        across = np.eye(3) - self.direction[:, :, None] * self.direction[:, None, :]
        across = across / (away * CLICK_RAD)[:, None, None] ** 2
        return np.asarray(across.sum(0)), np.einsum("rij,rj->i", across, self.centre)

    def widest(self) -> float:
        """Largest angle between two of them, radians."""
        cosine = np.clip(self.direction @ self.direction.T, -1.0, 1.0)
        return float(np.arccos(cosine.min()))


def triangulate(point: KnownPoint, submodel: Submodel) -> Triangulated | NotTriangulated:
    """Find where a control point is in the world of a submodel."""
    row_of = {photo: row for row, photo in enumerate(submodel.photo.tolist())}
    clicked: dict[str, tuple[int, int]] = {}
    for number, photo in enumerate(point.photo.tolist()):
        if photo in row_of:
            clicked.setdefault(point.shown_by[number], (row_of[photo], number))
    names = [*clicked]
    if len(names) < 2:
        where = (
            f"is clicked in one joined photo only, {names[0]}" if names else "is clicked in no joined photo"
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
    """Say how exactly control points say where the photos are that show them; n photos of the submodel.

    What is known of a point is known of its photos, together: it counts once, however many they are.

    Parameters
    ----------
    submodel : Submodel
        In the world of the map: x and y are map pixels.

    Returns
    -------
    (n,) float64
        Standard deviations along both axes, map pixels; infinite for photos that show none.
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
    """Find the point on which most rays agree, and which these are; None where that is not one point."""
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
    """Find the point nearest to rays, in angles as they are seen from a point near to it."""
    start: Array = np.asarray(rays.centre.mean(0) + rays.direction.mean(0)) if near is None else near
    matrix, vector = rays.information(start)
    return np.asarray(np.linalg.solve(matrix, vector), np.float64)


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
