"""Position and heading of the query from all matches with photos of known extrinsics.

The relative pose of each verified photo gives the query's rotation and a line through the photo on which the
query was taken. Points along these lines are starting poses; each is scored by how many matches of all photos
are inliers to their epipolar lines, and the best are refined by all matches at once: iteratively reweighted
least squares with a Geman-McClure kernel and graduated non-convexity. Matches with known depth in the map's
photo also have a residual along their line: they fix the distance to the photo, so that one photo can be
enough. Priors hold the camera level and at about the height of the map's cameras.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST, MapExtrinsics
from webapp.core.geometry.robust import geman_mcclure, truncated_quadratic
from webapp.core.localize.pose_residuals import (
    Correspondences,
    DepthResidual,
    EpipolarResidual,
    VerifiedView,
    collect_correspondences,
    depth_residual,
    epipolar_residual,
)
from webapp.core.tuning import DEFAULT, PoseTuning

Array = NDArray[np.float64]


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
