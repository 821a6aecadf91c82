"""Position and heading of the query from all matches with photos of known extrinsics.

The relative pose of each verified photo gives the query's rotation and a line through the photo on which the
query was taken. Points along these lines are starting poses; each is scored by how many matches of all photos
are inliers to their epipolar lines, and the best are refined by all matches at once: iteratively reweighted
least squares with a Geman-McClure kernel and graduated non-convexity. Matches with known depth in the map's
photo also have a residual along their line: they fix the distance to the photo, so that one photo can be
enough. Priors hold the camera level and at about the height of the map's cameras.

A match restricts the query's keypoint to an epipolar line. If the depth of the point in the map's photo is
known, its position on the line is known, too. Both residuals are scalars in the unit of rays at depth 1;
their standard deviation follows from the noise of keypoints in the query and in the photo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST, MapExtrinsics
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.geometry.robust import geman_mcclure, truncated_quadratic
from webapp.core.tuning import DEFAULT, PoseTuning

Array = NDArray[np.float64]

_PARALLEL_SIGMAS = 2.2
"""Rays at a smaller angle than this many sigmas are parallel: their point may be at infinity."""

_LEAST_DEPTH = 1e-3
"""Minimum depth of a point in front of the query, over its depth in the map's photo."""

_NO_MOTION = 1e-6
"""Displacement of a point, at depth 1, from infinity to its depth, below which there is no epipolar line."""

MIN_DEPTHS = 3
"""Minimum number of depths of a photo: with fewer, a single wrong one could decide."""


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedView:
    """A verified photo as input of pose estimation."""

    photo: int  # Its number in the map
    pose: RelativePose
    # `query_ray`, `photo_ray`: (m, 3) float64. Rays of all its matches in the camera frames, at depth 1.
    query_ray: Array
    photo_ray: Array
    # `inverse_depth`, `sigma`: (m,) float64. Inverse depths of the points in the photo's frame, per map
    # pixel, and their standard deviations; NaN where unknown.
    inverse_depth: Array
    sigma: Array
    ray_sigma: tuple[float, float]  # Standard deviations of the query's and the photo's rays at depth 1

    @property
    def has_depths(self) -> bool:
        """Whether enough inliers have a depth."""
        return int(np.isfinite(self.inverse_depth[self.pose.inlier]).sum()) >= MIN_DEPTHS


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """The m matches with all oriented photos, those of known depth first."""

    query: Array  # (m, 3) float64. Rays in the query's frame.
    photo: Array  # (m, 3) float64. Rays of the map's photos, rotated into the world.
    centre: Array  # (m, 3) float64. Camera centres of the photos, world.
    view: NDArray[np.int64]  # (m,) int64. Number of the view.
    # `inverse_depth`, `depth_sigma`: (d,) float64. Of the first d matches: inverse depths in the photos, per
    # map pixel.
    inverse_depth: Array
    depth_sigma: Array
    # `query_ray_sigma`, `photo_ray_sigma`: (m,) float64. Standard deviations of the rays, at depth 1.
    query_ray_sigma: Array
    photo_ray_sigma: Array
    views: int
    radius: float  # The place radius, map pixels
    min_depth: float  # Minimum depth of a matched point, map pixels


def collect_correspondences(
    views: Sequence[VerifiedView],
    usable: list[int],
    *,
    world: Array,
    extrinsics: MapExtrinsics,
    radius: float,
    min_depth: float,
) -> Correspondences:
    """Collect the matches of the usable views.

    Args:
        usable: Numbers of the views whose photos have extrinsics.
        world: (p, 3) float64. Camera centres of the map's photos.
        radius, min_depth: Map pixels.
    """
    chosen = [views[n] for n in usable]
    lengths = [len(v.query_ray) for v in chosen]
    inverse_depth = np.concatenate(
        [
            v.inverse_depth if v.has_depths else np.full(n, np.nan)
            for v, n in zip(chosen, lengths, strict=True)
        ]
    )
    order = np.argsort(np.isnan(inverse_depth), kind="stable")
    known = order[: np.isfinite(inverse_depth).sum()]
    query_ray_sigma, photo_ray_sigma = np.repeat([v.ray_sigma for v in chosen], lengths, axis=0)[order].T
    return Correspondences(
        query=np.concatenate([v.query_ray for v in chosen])[order],
        photo=np.concatenate([v.photo_ray @ extrinsics.rotation[v.photo] for v in chosen])[order],
        centre=np.repeat(world[[v.photo for v in chosen]], lengths, axis=0)[order],
        view=np.repeat(np.array(usable, np.int64), lengths)[order],
        inverse_depth=inverse_depth[known],
        depth_sigma=np.concatenate([v.sigma for v in chosen])[known],
        query_ray_sigma=query_ray_sigma,
        photo_ray_sigma=photo_ray_sigma,
        views=len(views),
        radius=radius,
        min_depth=min_depth,
    )


_Vectors = tuple[Array, Array, Array]
"""Vectors as separate components x, y and z: many times faster than one array (..., 3)."""


def _cross(u: _Vectors, v: _Vectors) -> _Vectors:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _dot(u: _Vectors, v: _Vectors) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _vectors(of: Array) -> _Vectors:
    return of[:, 0], of[:, 1], of[:, 2]


def _rows(rotation: Array) -> list[_Vectors]:
    """Return the three rows of (s, 3, 3) rotations as vectors (s, 1)."""
    return [(r[:, 0, None], r[:, 1, None], r[:, 2, None]) for r in np.swapaxes(rotation, 0, 1)]


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarResidual:
    """Residuals of m matches across their epipolar lines under s poses; all arrays are (s, m)."""

    value: Array  # array. Sampson error at depth 1.
    sigma: Array  # array. Standard deviation of `value` for a right match.
    # array. 1 where the point is in front of both cameras and not too near, or too far to decide; else 0.
    in_front: Array
    _query: _Vectors
    """The query's rays in the world."""
    _to_photo: _Vectors
    """Unit vectors from the query to the photo."""
    _photo_baseline: _Vectors
    _query_photo: _Vectors
    """Cross products of the photo's ray with `_to_photo`, and of both rays."""
    _length: Array
    """Length of the baseline, map pixels."""
    _gradient: Array
    """Norm of the constraint's gradient, by which the epipolar constraint is divided to give `value`."""

    def derivatives(self, radius: float) -> Array:
        """Compute derivatives (s, 6, m) of `value` by query rotation in the world and position in radii."""
        turn = _cross(self._query, self._photo_baseline)
        part = _dot(self._query_photo, self._to_photo)
        place = (v - part * w for v, w in zip(self._query_photo, self._to_photo, strict=True))
        by_place = -radius / (self._length * self._gradient)
        return np.stack([*(v / self._gradient for v in turn), *(v * by_place for v in place)], axis=1)


def epipolar_residual(matches: Correspondences, *, rotation: Array, centre: Array) -> EpipolarResidual:
    """Compute the residuals of all matches across their epipolar lines under poses (s, 3, 3), (s, 3)."""
    rotated = np.swapaxes(rotation, 1, 2) @ matches.query.T
    a, b = (rotated[:, 0], rotated[:, 1], rotated[:, 2]), _vectors(matches.photo)
    x, y, z = (matches.centre[:, i] - centre[:, i, None] for i in range(3))
    length = np.sqrt(_dot((x, y, z), (x, y, z))) + 1e-9
    to_photo = (x / length, y / length, z / length)
    b_t, t_a, a_b = _cross(b, to_photo), _cross(to_photo, a), _cross(a, b)
    query_gradient = sum(_dot(row, b_t) ** 2 for row in _rows(rotation)[:2])
    # The photo's rotation is not at hand to project on its image plane; the whole vector differs little.
    along_query = _dot(t_a, t_a)
    gradient = np.sqrt(query_gradient + along_query) + 1e-9
    variance = matches.query_ray_sigma**2 * query_gradient + matches.photo_ray_sigma**2 * along_query
    # The point is the intersection of the rays. With t to the photo, (t x b)(a x b) and (t x a)(a x b) have
    # the signs of its depths, which are the baseline times |t x b| and |t x a| over |a x b|.
    ahead = (_dot(b_t, a_b) <= 0.0) & (_dot(t_a, a_b) >= 0.0)
    angle = _dot(a_b, a_b)
    far = np.minimum(along_query, _dot(b_t, b_t)) * length**2 >= matches.min_depth**2 * angle
    parallel = angle < _PARALLEL_SIGMAS**2 * (matches.query_ray_sigma**2 + matches.photo_ray_sigma**2)
    return EpipolarResidual(
        value=_dot(a, b_t) / gradient,
        sigma=np.sqrt(variance + 1e-18) / gradient,
        in_front=((ahead & far) | parallel).astype(np.float64),
        _query=a,
        _to_photo=to_photo,
        _photo_baseline=b_t,
        _query_photo=a_b,
        _length=length,
        _gradient=gradient,
    )


@dataclass(frozen=True, slots=True, eq=False)
class DepthResidual:
    """Residuals of the d matches of known depth along their epipolar lines; all arrays are (s, d)."""

    value: Array  # array. At depth 1.
    sigma: Array  # array. Standard deviation of `value` for a right match, from both keypoints and the depth.
    in_front: Array  # array. 1 where the point is in front of the query; else 0.
    _point: _Vectors
    """Vector from the query to the point, times the inverse depth."""
    _slope: _Vectors
    """Derivative of `value` by `_point`."""
    _inverse_depth: Array

    def derivatives(self, radius: float) -> Array:
        """Compute derivatives (s, 6, d) of `value` by query rotation in the world and position in radii."""
        by_place = -radius * self._inverse_depth
        return np.stack([*_cross(self._slope, self._point), *(v * by_place for v in self._slope)], axis=1)


def depth_residual(matches: Correspondences, *, rotation: Array, centre: Array) -> DepthResidual:
    """Compute the residuals of the matches of known depth along their lines under poses (s, 3, 3), (s, 3)."""
    count = len(matches.inverse_depth)
    baseline = tuple(matches.centre[:count, i] - centre[:, i, None] for i in range(3))
    point = tuple(
        matches.inverse_depth * g + p for g, p in zip(baseline, matches.photo[:count].T, strict=True)
    )
    rows = _rows(rotation)
    u, v, depth = (_dot(row, (point[0], point[1], point[2])) for row in rows)
    ahead = depth > _LEAST_DEPTH
    depth = np.where(ahead, depth, _LEAST_DEPTH)
    u, v = u / depth, v / depth
    du, dv = u - matches.query[:count, 0], v - matches.query[:count, 1]
    # As the depth changes, the point moves along the epipolar line. Without a baseline there is no line: use
    # the whole displacement.
    gap_u, gap_v, gap_depth = (_dot(row, (baseline[0], baseline[1], baseline[2])) for row in rows)
    move_u, move_v = (gap_u - u * gap_depth) / depth, (gap_v - v * gap_depth) / depth
    move = np.hypot(move_u, move_v)
    still = move * matches.inverse_depth < _NO_MOTION
    line_u, line_v = np.where(still, du, move_u), np.where(still, dv, move_v)
    length = np.hypot(line_u, line_v) + 1e-12
    by_u, by_v = line_u / length, line_v / length
    by_depth = by_u * u + by_v * v
    slope = [(by_u * r + by_v * s - by_depth * t) / depth for r, s, t in zip(*rows, strict=True)]
    # Noise in the photo is magnified as the query gets nearer to the point.
    variance = matches.query_ray_sigma[:count] ** 2 + (matches.photo_ray_sigma[:count] / depth) ** 2
    return DepthResidual(
        value=du * by_u + dv * by_v,
        sigma=np.sqrt(variance + (move * matches.depth_sigma) ** 2),
        in_front=ahead.astype(np.float64),
        _point=(point[0], point[1], point[2]),
        _slope=(slope[0], slope[1], slope[2]),
        _inverse_depth=matches.inverse_depth,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A pose of the query that explains many matches."""

    # `x`, `y`: Map pixels.
    x: float
    y: float
    heading: float  # Radians clockwise from up
    score: float  # Approximate number of photos that agree
    # (2, 2) float64. Of (x, y), from the matches alone, as if their errors were independent.
    covariance_px2: Array
    agreement: Array  # (n,) float64. Agreement of each view, 0 to 1.


def estimate_poses(
    views: Sequence[VerifiedView],
    position: Array,
    *,
    extrinsics: MapExtrinsics,
    place_radius_px: float,
    tuning: PoseTuning = DEFAULT.pose,
) -> list[PoseEstimate]:
    """Estimate poses of the query.

    Args:
        views: n verified photos.
        position: (p, 2) float64. Positions of the map's photos, map pixels.
        extrinsics: Of the map's photos.

    Returns:
        The best first; empty if no photo of known extrinsics was verified.
    """
    world = extrinsics.centres(position)
    usable = [n for n, v in enumerate(views) if extrinsics.trust[v.photo] >= MIN_TRUST]
    rotation, centre = _initial_poses(
        [views[n] for n in usable], world, extrinsics=extrinsics, radius=place_radius_px, tuning=tuning
    )
    if not len(rotation):
        return []
    matches = collect_correspondences(
        views,
        usable,
        world=world,
        extrinsics=extrinsics,
        radius=place_radius_px,
        min_depth=tuning.min_depth * place_radius_px,
    )
    score, _ = _score(matches, rotation, centre, inlier_sigmas=tuning.start_inlier_sigmas, tuning=tuning)
    chosen = _suppress_neighbours(centre, score, tuning.starts_apart * place_radius_px)[: tuning.starts]
    rotation, centre, information = _refine(matches, rotation[chosen], centre[chosen], tuning=tuning)
    score, agreement = _score(matches, rotation, centre, inlier_sigmas=tuning.inlier_sigmas, tuning=tuning)
    heading = so3.heading(rotation)
    poses = [
        PoseEstimate(
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


def _initial_poses(
    views: Sequence[VerifiedView],
    world: Array,
    *,
    extrinsics: MapExtrinsics,
    radius: float,
    tuning: PoseTuning,
) -> tuple[Array, Array]:
    """Compute (s, 3, 3) rotations and (s, 3) centres of starting poses."""
    rotations, centres = [], []
    for view in views:
        if view.pose.trust < tuning.min_trust:
            continue
        photo = extrinsics.rotation[view.photo]
        to_query = photo.T @ view.pose.translation
        rotation = view.pose.rotation.T @ photo
        starts = (radius * d for d in tuning.start_distances)
        for distance in (*starts, *_distance_from_depths(view, photo, to_query)):
            rotations.append(rotation)
            centres.append(world[view.photo] + distance * to_query)
    return np.array(rotations).reshape(-1, 3, 3), np.array(centres).reshape(-1, 3)


def _distance_from_depths(view: VerifiedView, photo: Array, to_query: Array) -> list[float]:
    """Estimate the distance from a photo to the query as a weighted median over the known depths.

    Args:
        photo: (3, 3) float64. Rotation, photo's camera from world.
        to_query: (3,) float64. Direction, world.
    """
    if not view.has_depths:
        return []
    known = view.pose.inlier & np.isfinite(view.inverse_depth)
    ray = view.query_ray[known] @ view.pose.rotation.T @ photo
    point = view.photo_ray[known] @ photo / view.inverse_depth[known, None]
    aside, base = np.cross(ray, point), np.cross(ray, to_query)
    squared = np.maximum((base**2).sum(1), 1e-12)
    distance = (aside * base).sum(1) / squared
    order = np.argsort(distance)
    weight = np.cumsum((np.sqrt(squared) * view.inverse_depth[known])[order])
    return [float(distance[order][np.searchsorted(weight, weight[-1] / 2.0)])]


def _suppress_neighbours(centre: Array, score: Array, distance: float) -> list[int]:
    """Sort points by descending score and drop those close to a better one (non-maximum suppression)."""
    near = np.linalg.norm(centre[:, None] - centre[None], axis=2) <= distance
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable").tolist():
        if not near[i, kept].any():
            kept.append(i)
    return kept


def _score(
    matches: Correspondences, rotation: Array, centre: Array, *, inlier_sigmas: float, tuning: PoseTuning
) -> tuple[Array, Array]:
    """Score s poses by their inliers; returns (s,) scores and (s, n) agreements of the views."""
    agrees = _inlier_score(epipolar_residual(matches, rotation=rotation, centre=centre), inlier_sigmas)
    by_depth = depth_residual(matches, rotation=rotation, centre=centre)
    agrees[:, : len(matches.inverse_depth)] *= _inlier_score(by_depth, inlier_sigmas)
    offset = matches.centre[None] - centre[:, None]
    agrees = agrees * np.exp(-np.hypot(offset[..., 0], offset[..., 2]) / (tuning.reach * matches.radius))
    counts = np.stack([np.bincount(matches.view, weights=row, minlength=matches.views) for row in agrees])
    agreement = 1.0 - np.exp(-np.maximum(counts - tuning.chance_inliers, 0.0) / tuning.inlier_scale)
    roll = np.degrees(np.arcsin(np.clip(rotation[:, 0, 1], -1.0, 1.0)))
    return agreement.sum(1) / (1.0 + (roll / tuning.roll_deg) ** 2), agreement


def _inlier_score(residual: EpipolarResidual | DepthResidual, sigmas: float) -> Array:
    return truncated_quadratic(residual.value**2, sigmas * residual.sigma) * residual.in_front


def _refine(
    matches: Correspondences, rotation: Array, centre: Array, *, tuning: PoseTuning
) -> tuple[Array, Array, Array]:
    """Refine s poses by Gauss-Newton; returns rotations, centres, and (s, 6, 6) information."""
    height = float(np.median(matches.centre[:, 1]))
    for factor in tuning.annealing.factors():
        matrix, vector = _normal_equations(
            matches, rotation, centre, factor=factor, height=height, tuning=tuning
        )
        step = so3.solve_batched(matrix + 1e-3 * np.eye(6), vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step[:, :3], tuning.max_rotation_step))
        centre = centre + so3.clamp_norm(step[:, 3:], tuning.max_translation_step) * matches.radius
    information, _ = _normal_equations(matches, rotation, centre, factor=1.0, height=height, tuning=tuning)
    return rotation, centre, information


def _normal_equations(
    matches: Correspondences,
    rotation: Array,
    centre: Array,
    *,
    factor: float,
    height: float,
    tuning: PoseTuning,
) -> tuple[Array, Array]:
    """Build the normal equations of s poses: (s, 6, 6) and (s, 6), by rotation and translation in radii.

    Sigmas of residuals are multiplied by `factor`; priors hold the camera level and at `height`.
    """
    by_line = epipolar_residual(matches, rotation=rotation, centre=centre)
    by_depth = depth_residual(matches, rotation=rotation, centre=centre)
    matrix, vector = _residual_equations(by_line, factor=factor, radius=matches.radius)
    more = _residual_equations(by_depth, factor=factor, radius=matches.radius)
    matrix, vector = matrix + more[0], vector + more[1]
    level = tuning.level.normal_equations(rotation)
    matrix[:, :3, :3] += level[0]
    vector[:, :3] += level[1]
    matrix[:, 4, 4] += 1.0 / tuning.height_sigma**2
    vector[:, 4] -= (centre[:, 1] - height) / matches.radius / tuning.height_sigma**2
    return matrix, vector


def _residual_equations(
    residual: EpipolarResidual | DepthResidual, *, factor: float, radius: float
) -> tuple[Array, Array]:
    """Build the normal equations (s, 6, 6) and (s, 6) of robustly weighted residuals."""
    sigma = factor * residual.sigma
    weight = residual.in_front * geman_mcclure(residual.value**2, sigma) / sigma**2
    jacobian = residual.derivatives(radius)
    weighted = jacobian * weight[:, None]
    return weighted @ np.swapaxes(jacobian, 1, 2), -(weighted @ residual.value[..., None])[..., 0]


def _covariance(information: Array, radius: float) -> Array:
    """Compute the covariance of (x, y), map pixels squared, from the information matrix."""
    whole = np.linalg.inv(information + 1e-9 * np.eye(6))[np.ix_([3, 5], [3, 5])] * radius**2
    flip = np.diag([1.0, -1.0])  # y is down the map, z is north
    covariance: Array = flip @ whole @ flip
    return covariance
