"""How far matches are from agreeing with poses of the query: off their epipolar lines, and along them.

Of every match it is known on which line of the query it must lie. Where the point's depth in the map's photo
is known too, it is known where on the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.extrinsics import MapExtrinsics
from webapp.core.geometry.relative_pose import RelativePose

Array = NDArray[np.float64]

NOISE = 2.0 / 450.0
"""Spread of a right match, at depth 1, orientations of the map's photos included."""

_PARALLEL = 1e-4
"""Squared sine of the angle between rays that are too parallel to tell front from behind."""

_LEAST_DEPTH = 1e-3
"""Of a point in front of the query, over its depth in the map's photo."""

MIN_DEPTHS = 3
"""Fewer of a photo say nothing: one that is wrong would be believed."""


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedView:
    """A verified photo.

    Attributes
    ----------
    photo : int
        Its number in the map.
    pose : RelativePose
    query_ray, photo_ray : (m, 3) float64
        Of all its matches, camera frames, depth 1.
    inverse_depth, sigma : (m,) float64
        Inverse depths of what they show in the photo, per map pixel, and how uncertain; NaN where unknown.
    """

    photo: int
    pose: RelativePose
    query_ray: Array
    photo_ray: Array
    inverse_depth: Array
    sigma: Array

    @property
    def has_depths(self) -> bool:
        """Whether its depths are enough to rely on."""
        return int(np.isfinite(self.inverse_depth[self.pose.inlier]).sum()) >= MIN_DEPTHS


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """All matches with oriented photos; m of them, those of known depth first.

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
    inverse_depth, sigma : (d,) float64
        Of the first d matches: inverse depths in the photos, per map pixel.
    views : int
    radius : float
        The place radius.
    """

    query: Array
    photo: Array
    centre: Array
    view: NDArray[np.int64]
    inverse_depth: Array
    sigma: Array
    views: int
    radius: float


def collect_correspondences(
    views: Sequence[VerifiedView],
    usable: list[int],
    *,
    world: Array,
    extrinsics: MapExtrinsics,
    radius: float,
) -> Correspondences:
    """Put the matches of those views that are usable together; (p, 3) `world` tells where photos are."""
    chosen = [views[n] for n in usable]
    lengths = [len(v.query_ray) for v in chosen]
    inverse = np.concatenate(
        [
            v.inverse_depth if v.has_depths else np.full(n, np.nan)
            for v, n in zip(chosen, lengths, strict=True)
        ]
    )
    order = np.argsort(np.isnan(inverse), kind="stable")
    known = order[: np.isfinite(inverse).sum()]
    return Correspondences(
        query=np.concatenate([v.query_ray for v in chosen])[order],
        photo=np.concatenate([v.photo_ray @ extrinsics.rotation[v.photo] for v in chosen])[order],
        centre=np.repeat(world[[v.photo for v in chosen]], lengths, axis=0)[order],
        view=np.repeat(np.array(usable, np.int64), lengths)[order],
        inverse_depth=inverse[known],
        sigma=np.concatenate([v.sigma for v in chosen])[known],
        views=len(views),
        radius=radius,
    )


_Vectors = tuple[Array, Array, Array]
"""Vectors by their components, x, y and z, which is many times faster than one array (..., 3) of them."""


def _cross(u: _Vectors, v: _Vectors) -> _Vectors:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _dot(u: _Vectors, v: _Vectors) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _vectors(of: Array) -> _Vectors:
    return of[:, 0], of[:, 1], of[:, 2]


def _rows(rotation: Array) -> list[_Vectors]:
    """Give the three rows of (s, 3, 3) rotations as vectors (s, 1)."""
    return [(r[:, 0, None], r[:, 1, None], r[:, 2, None]) for r in np.swapaxes(rotation, 0, 1)]


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarResidual:
    """How far m matches are off their epipolar lines under s poses; all arrays are (s, m).

    Attributes
    ----------
    value : array
        Sampson's distance at depth 1.
    in_front : array
        1 where the matched point is in front of both cameras, or too far to tell; else 0.
    """

    value: Array
    in_front: Array
    _query: _Vectors
    """The query's rays in the world."""
    _to_photo: _Vectors
    """From the query to the photo, length 1."""
    _photo_along: _Vectors
    _query_photo: _Vectors
    """Cross products of the photo's ray with `_to_photo`, and of both rays."""
    _length: Array
    """Distance of the photo."""
    _size: Array
    """What makes `value` of the error of the epipolar constraint."""

    def derivatives(self, radius: float) -> Array:
        """Derivatives of `value` by a turn of the query in the world, and its place in radii; (s, 6, m)."""
        turn = _cross(self._query, self._photo_along)
        part = _dot(self._query_photo, self._to_photo)
        place = (v - part * w for v, w in zip(self._query_photo, self._to_photo, strict=True))
        by_place = -radius / (self._length * self._size)
        return np.stack([*(v / self._size for v in turn), *(v * by_place for v in place)], axis=1)


def epipolar_residual(scene: Correspondences, *, rotation: Array, centre: Array) -> EpipolarResidual:
    """Compare all matches with their epipolar lines under poses (s, 3, 3), (s, 3)."""
    turned = np.swapaxes(rotation, 1, 2) @ scene.query.T
    a, b = (turned[:, 0], turned[:, 1], turned[:, 2]), _vectors(scene.photo)
    x, y, z = (scene.centre[:, i] - centre[:, i, None] for i in range(3))
    length = np.sqrt(_dot((x, y, z), (x, y, z))) + 1e-9
    to_photo = (x / length, y / length, z / length)
    b_along, along_a, a_b = _cross(b, to_photo), _cross(to_photo, a), _cross(a, b)
    in_query = [_dot(row, b_along) for row in _rows(rotation)[:2]]
    # The photo's own image plane is not at hand; the whole vector differs little from its part in it.
    size = np.sqrt(in_query[0] ** 2 + in_query[1] ** 2 + _dot(along_a, along_a)) + 1e-9
    # The point lies where both rays meet; with d to the photo, (d x b)(a x b) and (d x a)(a x b) tell the
    # signs of its depths.
    ahead = (_dot(b_along, a_b) <= 0.0) & (_dot(along_a, a_b) >= 0.0) | (_dot(a_b, a_b) < _PARALLEL)
    off = _dot(a, b_along) / size
    return EpipolarResidual(off, ahead.astype(np.float64), a, to_photo, b_along, a_b, length, size)


@dataclass(frozen=True, slots=True, eq=False)
class DepthResidual:
    """How far the d matches of known depth are off along their epipolar lines; all arrays are (s, d).

    Attributes
    ----------
    value : array
        At depth 1.
    in_front : array
        1 where the point is in front of the query; else 0.
    sigma : array
        Spread of `value` for a right match, in units of `NOISE`: by the query, the photo and the depth.
    """

    value: Array
    in_front: Array
    sigma: Array
    _point: _Vectors
    """From the query, times the inverse depth."""
    _slope: _Vectors
    """Derivative of `value` by `_point`."""
    _inverse: Array

    def derivatives(self, radius: float) -> Array:
        """Derivatives of `value` by a turn of the query in the world, and its place in radii; (s, 6, d)."""
        by_place = -radius * self._inverse
        return np.stack([*_cross(self._slope, self._point), *(v * by_place for v in self._slope)], axis=1)


def depth_residual(scene: Correspondences, *, rotation: Array, centre: Array) -> DepthResidual:
    """Compare the matches of known depth with where their points are seen under poses (s, 3, 3), (s, 3)."""
    count = len(scene.inverse_depth)
    to_x, to_y, to_z = (scene.centre[:count, i] - centre[:, i, None] for i in range(3))
    gap = (to_x, to_y, to_z)
    x, y, z = (scene.inverse_depth * g + p for g, p in zip(gap, scene.photo[:count].T, strict=True))
    rows = _rows(rotation)
    u, v, depth = (_dot(row, (x, y, z)) for row in rows)
    ahead = depth > _LEAST_DEPTH
    depth = np.where(ahead, depth, _LEAST_DEPTH)
    u, v = u / depth, v / depth
    # As the depth changes, the point moves along the epipolar line.
    gap_u, gap_v, gap_depth = (_dot(row, gap) for row in rows)
    move_u, move_v = (gap_u - u * gap_depth) / depth, (gap_v - v * gap_depth) / depth
    move = np.hypot(move_u, move_v) + 1e-9
    by_u, by_v = move_u / move, move_v / move
    off = (u - scene.query[:count, 0]) * by_u + (v - scene.query[:count, 1]) * by_v
    by_depth = by_u * u + by_v * v
    slope_x, slope_y, slope_z = (
        (by_u * r + by_v * s - by_depth * t) / depth for r, s, t in zip(*rows, strict=True)
    )
    # Noise in the photo is seen the larger, the nearer the query is to the point.
    wider = np.sqrt(1.0 + depth**-2.0 + (move * scene.sigma / NOISE) ** 2)
    return DepthResidual(
        off, ahead.astype(np.float64), wider, (x, y, z), (slope_x, slope_y, slope_z), scene.inverse_depth
    )
