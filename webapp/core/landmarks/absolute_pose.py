"""Pose of a camera in a landmark cloud: descriptor matching, then perspective-three-point in a RANSAC.

The focal length, which may be a guess, is refined with the pose, and the covariance includes what the points
leave open of it.

Matching is exact and only against points that photos like the query see (covisibility): T. Sattler, B. Leibe,
L. Kobbelt, "Efficient & effective prioritized matching for large-scale image-based localization", 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import faiss
import numpy as np
import poselib
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.robust import truncated_quadratic
from webapp.core.landmarks.cloud import LandmarkCloud

Array = NDArray[np.float64]

_STEEP = np.sin(np.radians(10.0))
"""Sine of the angle between a camera and the vertical below which it looks straight down or up."""

MIN_INLIERS = 12
"""Least number of inliers: fewer may agree by chance where most matches are wrong."""

_RATIO = 0.85
"""Ratio test against the next point: looser among few points than over a whole map."""

_NEIGHBOURS = 5
"""Nearest observations per query descriptor: several, as the nearest ones often show the same point."""

_MAX_ERROR = 0.006
"""Largest reprojection error of an inlier, as a fraction of the longer side."""

_RANSAC = {"max_iterations": 2000, "min_iterations": 100, "success_prob": 0.9999, "seed": 0}
_BUNDLE = {"max_iterations": 25, "loss_type": "CAUCHY"}
_LEAST_SIGMA = 0.0005
"""Lower limit of a keypoint's standard deviation, as a fraction of the longer side."""

_REFINEMENTS, _STEPS, _SETTLED = 3, 20, 1e-6
"""Rounds with new inliers, steps of a round, and relative change of the cost that ends it."""

_UNDISTORT_ROUNDS, _LEAST_WIDENING = 10, 0.1
"""Fixed-point undistortion: iterations, and lower limit of the divisor."""


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics of a camera whose principal point is the image centre."""

    # `width`, `height`: Pixels of the upright photo.
    width: int
    height: int
    focal_px: float
    # Radial coefficient of the squared distance from the centre at depth 1 (COLMAP's SIMPLE_RADIAL).
    distortion: float = 0.0
    focal_sigma: float = 0.0  # Standard deviation of the focal length, as a fraction of it; 0: it is exact.

    @property
    def longer_px(self) -> int:
        """Longer side of the photo."""
        return max(self.width, self.height)


@dataclass(frozen=True, slots=True, eq=False)
class AbsolutePose:
    """Pose of a camera in the world of a cloud."""

    centre: Array  # (3,) float64
    rotation: Array  # (3, 3) float64. Camera from world.
    # (6, 6) float64. Of the centre, and of a small rotation in the camera's own frame, radians.
    covariance: Array
    inlier: NDArray[np.bool_]  # (m,) bool. Which matches agree.
    score: float  # MSAC score, in matches
    lens: Lens  # With the focal length that was estimated


def match_points(
    query: NDArray[np.uint8], descriptors: NDArray[np.uint8], *, point: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Match descriptors to points, by a ratio test between different points.

    Args:
        query: (n, d) uint8
        descriptors: (m, d) uint8. Of observations.
        point: (m,) int32. Point of each observation.

    Returns:
        query_row, row: (k,) int64. Rows of `query`, and the nearest observation of each; a point is matched
            once.
    """
    if len(query) == 0 or len(descriptors) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    count = min(_NEIGHBOURS, len(descriptors))
    squared, near = faiss.knn(query.astype(np.float32), descriptors.astype(np.float32), count)
    # second best: the first neighbour that shows another point, or the last neighbour as a lower bound
    other = point[near] != point[near[:, :1]]
    following = np.where(other.any(1), other.argmax(1), count - 1)
    best, row = squared[:, 0], near[:, 0]
    clear = np.flatnonzero(best < _RATIO**2 * squared[np.arange(len(query)), following])
    # of several keypoints matched to one point, keep the nearest
    clear = clear[np.argsort(best[clear], kind="stable")]
    clear = np.sort(clear[np.unique(point[row[clear]], return_index=True)[1]])
    return clear, row[clear]


class SolvedCamera(NamedTuple):
    """A camera pose and its m matches: keypoints of the query, observations of the cloud."""

    pose: AbsolutePose | NoPose
    query_row: NDArray[np.int64]
    seen: NDArray[np.int64]


def solve_camera(
    query: Features, cloud: LandmarkCloud, *, rows: NDArray[np.int64], lenses: Sequence[Lens]
) -> SolvedCamera:
    """Match a query with some observations of a cloud and estimate its camera pose.

    Args:
        rows: (n,) int64. The observations.
        lenses: Candidates for the query's camera; the one with the best score is chosen.
    """
    row, near = match_points(query.descriptors, cloud.descriptors[rows], point=cloud.seen_point[rows])
    seen = rows[near]
    xy, points = query.xy[row].astype(np.float64), cloud.point[cloud.seen_point[seen]]
    solved = [absolute_pose(xy, points, lens=lens) for lens in lenses]
    best = max(solved, key=lambda one: one.score if isinstance(one, AbsolutePose) else 0.0)
    return SolvedCamera(best, row, seen)


def absolute_pose(xy: Array, points: Array, *, lens: Lens) -> AbsolutePose | NoPose:
    """Estimate a camera pose from pixels and the points that they show.

    Args:
        xy: (m, 2) float64. Pixels, centres at whole numbers.
        points: (m, 3) float64
    """
    if len(xy) < MIN_INLIERS:
        return NoPose(f"{len(xy)} landmarks, {MIN_INLIERS} needed")
    params = [lens.focal_px, (lens.width - 1) / 2.0, (lens.height - 1) / 2.0, lens.distortion]
    camera = {"model": "SIMPLE_RADIAL", "width": lens.width, "height": lens.height, "params": params}
    limit = _MAX_ERROR * lens.longer_px
    options = {**_RANSAC, "max_reproj_error": limit}
    pose, info = poselib.estimate_absolute_pose(
        xy, points, camera, options, {**_BUNDLE, "loss_scale": limit / 3.0}
    )
    inlier = np.asarray(info["inliers"], bool)
    if inlier.sum() < MIN_INLIERS:
        return NoPose(f"{int(inlier.sum())} landmarks agree, {MIN_INLIERS} needed")
    rotation = np.asarray(pose.R, np.float64)
    found = _State(lens, rotation, -rotation.T @ np.asarray(pose.t, np.float64))
    if lens.focal_sigma:
        found, inlier = _with_focal(found, xy, points, inlier=inlier, limit=limit)
    off = found.off(xy[inlier], points[inlier])
    covariance = _covariance(found, off, points[inlier])
    if covariance is None:
        return NoPose("the landmarks do not determine the camera's position")
    score = float(truncated_quadratic((off**2).sum(1), limit).sum())
    return AbsolutePose(found.centre, found.rotation, covariance, inlier, score, found.lens)


def project(points: Array, *, lens: Lens, rotation: Array, centre: Array) -> Array:
    """Project (m, 3) points to (m, 2) pixels."""
    own = (points - centre) @ rotation.T
    flat = own[:, :2] / own[:, 2:]
    wide = 1.0 + lens.distortion * (flat**2).sum(1, keepdims=True)
    middle = np.array([(lens.width - 1) / 2.0, (lens.height - 1) / 2.0])
    projected: Array = lens.focal_px * wide * flat + middle
    return projected


def ray_of_pixel(xy: Array, *, lens: Lens) -> Array:
    """Return the viewing ray of a pixel (2,): a unit vector (3,), right, down and front."""
    middle = np.array([(lens.width - 1) / 2.0, (lens.height - 1) / 2.0])
    seen: Array = (xy - middle) / lens.focal_px
    flat = seen
    for _ in range(_UNDISTORT_ROUNDS):
        flat = seen / max(1.0 + lens.distortion * float(flat @ flat), _LEAST_WIDENING)
    ray = np.append(flat, 1.0)
    unit: Array = ray / np.linalg.norm(ray)
    return unit


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A camera that is estimated."""

    lens: Lens
    rotation: Array  # (3, 3) float64. Camera from world.
    centre: Array  # (3,) float64

    def off(self, xy: Array, points: Array) -> Array:
        """Residuals (m, 2), pixels."""
        return xy - project(points, lens=self.lens, rotation=self.rotation, centre=self.centre)

    def moved(self, step: Array) -> _State:
        """Add a step (7,): of the centre, of a rotation in the camera's frame, of log focal length."""
        lens = replace(self.lens, focal_px=self.lens.focal_px * float(np.exp(step[6])))
        return _State(lens, so3.exp(step[3:6]) @ self.rotation, self.centre + step[:3])

    def jacobian(self, points: Array) -> Array:
        """Derivatives (m, 2, 7) of the projections by such a step."""
        own = (points - self.centre) @ self.rotation.T
        by_own = projection_jacobian(own, focal_px=self.lens.focal_px, distortion=self.lens.distortion)
        cross = np.zeros((len(points), 3, 3))
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -own[:, 2], own[:, 1], -own[:, 0]
        cross -= np.swapaxes(cross, 1, 2)
        middle = np.array([(self.lens.width - 1) / 2.0, (self.lens.height - 1) / 2.0])
        seen = project(points, lens=self.lens, rotation=self.rotation, centre=self.centre) - middle
        return np.concatenate([-by_own @ self.rotation, -by_own @ cross, seen[:, :, None]], 2)


def _with_focal(
    begun: _State, xy: Array, points: Array, *, inlier: NDArray[np.bool_], limit: float
) -> tuple[_State, NDArray[np.bool_]]:
    """Refine pose and focal length; matches that agree only then become inliers."""
    given = begun.lens.focal_px
    best, score = (begun, inlier), _score(begun, xy, points, limit=limit)
    state = begun
    for _ in range(_REFINEMENTS):
        state = _adjusted(state, xy[inlier], points[inlier], given=given, limit=limit)
        inlier = (state.off(xy, points) ** 2).sum(1) < limit**2
        better = _score(state, xy, points, limit=limit)
        if inlier.sum() < MIN_INLIERS or better <= score:
            break
        best, score = (state, inlier), better
    return best


def _score(state: _State, xy: Array, points: Array, *, limit: float) -> float:
    return float(truncated_quadratic((state.off(xy, points) ** 2).sum(1), limit).sum())


def _adjusted(state: _State, xy: Array, points: Array, *, given: float, limit: float) -> _State:
    """Minimise a Cauchy loss, with the given focal length as a prior (Levenberg-Marquardt)."""
    scale = (limit / 3.0) ** 2
    least = _LEAST_SIGMA * state.lens.longer_px
    sigma = max(float(np.sqrt((state.off(xy, points) ** 2).mean())), least)

    def cost(one: _State) -> float:
        squared = (one.off(xy, points) ** 2).sum(1)
        prior = np.log(one.lens.focal_px / given) / one.lens.focal_sigma
        return float(scale * np.log1p(squared / scale).sum() / sigma**2 + prior**2)

    damping, now = 1e-4, cost(state)
    for _ in range(_STEPS):
        off, jacobian = state.off(xy, points), state.jacobian(points)
        weight = (1.0 / (1.0 + (off**2).sum(1) / scale) / sigma**2)[:, None]
        normal = np.einsum("nki,nk,nkj->ij", jacobian, weight + np.zeros_like(off), jacobian)
        gradient = np.einsum("nki,nk->i", jacobian, weight * off)
        normal[6, 6] += state.lens.focal_sigma**-2.0
        gradient[6] -= np.log(state.lens.focal_px / given) * state.lens.focal_sigma**-2.0
        step = np.linalg.solve(normal + damping * np.diag(np.diagonal(normal) + 1e-300), gradient)
        trial = state.moved(step)
        after = cost(trial)
        if not after < now:
            damping *= 10.0
            continue
        settled = now - after < _SETTLED * now
        state, now, damping = trial, after, damping / 10.0
        if settled:
            break
    return state


def _covariance(state: _State, off: Array, points: Array) -> Array | None:
    """Invert the normal matrix, scaled by the residuals `off`; None if it is singular."""
    lens = state.lens
    free = max(off.size - 6, 1)
    sigma = max(float(np.sqrt((off**2).sum() / free)), _LEAST_SIGMA * lens.longer_px)
    jacobian = state.jacobian(points).reshape(-1, 7) / sigma
    if not lens.focal_sigma:
        jacobian = jacobian[:, :6]
    normal = jacobian.T @ jacobian
    if lens.focal_sigma:
        normal[6, 6] += lens.focal_sigma**-2.0
    scale = np.sqrt(np.diagonal(normal))
    normal /= np.outer(scale, scale)
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e12:
        return None
    covariance: Array = np.linalg.inv(normal) / np.outer(scale, scale)
    return covariance[:6, :6]


def projection_jacobian(own: Array, *, focal_px: Array | float, distortion: Array | float) -> Array:
    """Return the derivatives (n, 2, 3) of projections, pixels, by the points (n, 3) in their camera frames.

    Args:
        focal_px, distortion: float or (n,) float64. See `Lens`.
    """
    focal, radial = (np.broadcast_to(value, len(own))[:, None, None] for value in (focal_px, distortion))
    depth = own[:, 2]
    flat = own[:, :2] / depth[:, None]
    squared = (flat**2).sum(1)[:, None, None]
    wide = (1.0 + radial * squared) * np.eye(2) + 2.0 * radial * flat[:, :, None] * flat[:, None, :]
    by_own = np.zeros((len(own), 2, 3))
    by_own[:, 0, 0] = by_own[:, 1, 1] = 1.0 / depth
    by_own[:, :, 2] = -flat / depth[:, None]
    jacobian: Array = focal * (wide @ by_own)
    return jacobian


def euler_angles(rotation: Array) -> Array:
    """Return heading (clockwise from image-up), pitch and roll, radians, as in `CameraPose`.

    The rotation is camera from world, with world axes x right and y down on the map, and z down. For a camera
    that looks nearly straight down or up, as drones do, heading and roll are one rotation: the roll is 0.
    """
    right, forward = rotation[0], rotation[2]
    level = float(np.hypot(forward[0], forward[1]))
    pitch = np.arctan2(-forward[2], level)
    if level < _STEEP:
        return np.array([np.arctan2(right[1], right[0]), pitch, 0.0])
    heading = np.arctan2(forward[0], -forward[1])
    roll = np.arctan2(right[2], rotation[1, 2])
    return np.array([heading, pitch, roll])


def angle_jacobian(rotation: Array) -> Array:
    """Return the derivatives (3, 3) of `euler_angles` by a small rotation in the camera's own frame."""
    step = 1e-6
    base = euler_angles(rotation)
    columns = []
    for axis in np.eye(3):
        turned = so3.exp(step * axis) @ rotation
        columns.append(so3.wrap(euler_angles(turned) - base) / step)
    return np.stack(columns, 1)
