"""Position and heading from all matches with photos whose orientations are known.

Each verified photo, with its relative pose, says how the query was held and on which line through the photo
it was taken. Points along these lines are starting points; each is judged by how many matches, of all photos,
lie on their epipolar lines, and the best are refined by all matches at once. Matches whose depth in the map's
photo is known must also lie at the right place of their line: they tell how far away the photo was taken, so
that one photo can be enough. The camera is held about level; its height is about that of the map's cameras.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST, MapExtrinsics
from webapp.core.localize.pose_residuals import (
    NOISE,
    Correspondences,
    DepthResidual,
    EpipolarResidual,
    VerifiedView,
    collect_correspondences,
    depth_residual,
    epipolar_residual,
)

Array = NDArray[np.float64]

_DISTANCES = (0.15, 0.5, 1.0, 2.0)
"""Starting points on the line through a photo, in place radii from it."""

_LEAST_TRUST = 0.15
_STARTS = 4
"""So many starting points are refined."""

_STARTS_APART = 0.3
"""Starting points nearer to each other, in place radii, are one."""

_TOLERANCE = 1.25
"""Up to here a match agrees, in units of its spread; three times as far for starting points."""

_NEAR = 3.0
"""How fast a photo's say fades with its distance, in place radii."""

_BY_CHANCE, _MANY = 2.0, 20.0
"""Agreeing matches of a photo that mean nothing, and a scale for more of them."""

_ROLL_DEG = 6.0
_ROUNDS = 10
_WIDER, _NARROWING = 15.0, 0.65
_ROLL_SPREAD, _PITCH_SPREAD, _HEIGHT_SPREAD = 0.035, 0.35, 0.3
_MOST_TURN, _MOST_STEP = 0.2, 0.7


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
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


def estimate_poses(
    views: Sequence[VerifiedView],
    position: Array,
    *,
    extrinsics: MapExtrinsics,
    place_radius_px: float,
) -> list[PoseEstimate]:
    """Find poses of the query.

    Parameters
    ----------
    views : sequence of View
        n verified photos.
    position : (p, 2) float64
        Of the map's photos, map pixels.
    extrinsics : MapExtrinsics
        Of the map's photos.
    place_radius_px : float

    Returns
    -------
    list of Pose
        The best first; empty when no photo with a known orientation was verified.
    """
    world = extrinsics.centres(position)
    usable = [n for n, v in enumerate(views) if extrinsics.trust[v.photo] >= MIN_TRUST]
    rotation, centre = _initial_poses(
        [views[n] for n in usable], world, extrinsics=extrinsics, radius=place_radius_px
    )
    if not len(rotation):
        return []
    scene = collect_correspondences(views, usable, world=world, extrinsics=extrinsics, radius=place_radius_px)
    score, _ = _score(scene, rotation, centre, tolerance=3.0 * _TOLERANCE)
    chosen = _suppress_neighbours(centre, score, _STARTS_APART * place_radius_px)[:_STARTS]
    rotation, centre, information = _refine(scene, rotation[chosen], centre[chosen])
    score, agreement = _score(scene, rotation, centre, tolerance=_TOLERANCE)
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
    views: Sequence[VerifiedView], world: Array, *, extrinsics: MapExtrinsics, radius: float
) -> tuple[Array, Array]:
    """Give (s, 3, 3) rotations and (s, 3) centres to start from."""
    rotations, centres = [], []
    for view in views:
        if view.pose.trust < _LEAST_TRUST:
            continue
        photo = extrinsics.rotation[view.photo]
        to_query = photo.T @ view.pose.translation
        rotation = view.pose.rotation.T @ photo
        for distance in (*(radius * d for d in _DISTANCES), *_distance_from_depths(view, photo, to_query)):
            rotations.append(rotation)
            centres.append(world[view.photo] + distance * to_query)
    return np.array(rotations).reshape(-1, 3, 3), np.array(centres).reshape(-1, 3)


def _distance_from_depths(view: VerifiedView, photo: Array, to_query: Array) -> list[float]:
    """Tell at which distance from a photo the query was taken by the depths of what both see, if any.

    Parameters
    ----------
    view : View
    photo : (3, 3) float64
        Photo's camera from world.
    to_query : (3,) float64
        Direction, world.
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
    """Number the points by falling score, without those near a better one."""
    near = np.linalg.norm(centre[:, None] - centre[None], axis=2) <= distance
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable").tolist():
        if not near[i, kept].any():
            kept.append(i)
    return kept


def _score(
    scene: Correspondences, rotation: Array, centre: Array, *, tolerance: float
) -> tuple[Array, Array]:
    """Score s poses; returns (s,) scores and (s, n) agreements of the views."""
    agrees = _inlier_weight(epipolar_residual(scene, rotation=rotation, centre=centre), tolerance * NOISE)
    where = depth_residual(scene, rotation=rotation, centre=centre)
    agrees[:, : len(scene.inverse_depth)] *= _inlier_weight(where, tolerance * NOISE * where.sigma)
    distance = np.hypot(
        scene.centre[None, :, 0] - centre[:, None, 0], scene.centre[None, :, 2] - centre[:, None, 2]
    )
    agrees = agrees * np.exp(-distance / (_NEAR * scene.radius))
    counts = np.stack([np.bincount(scene.view, weights=row, minlength=scene.views) for row in agrees])
    agreement = 1.0 - np.exp(-np.maximum(counts - _BY_CHANCE, 0.0) / _MANY)
    roll = np.degrees(np.arcsin(np.clip(rotation[:, 0, 1], -1.0, 1.0)))
    return agreement.sum(1) / (1.0 + (roll / _ROLL_DEG) ** 2), agreement


def _inlier_weight(found: EpipolarResidual | DepthResidual, tolerance: float | Array) -> Array:
    agrees: Array = np.maximum(0.0, 1.0 - (found.value / tolerance) ** 2) * found.in_front
    return agrees


def _refine(scene: Correspondences, rotation: Array, centre: Array) -> tuple[Array, Array, Array]:
    """Refine s poses by all matches; returns rotations, centres, and (s, 6, 6) information (turn, step)."""
    level = float(np.median(scene.centre[:, 1]))
    for number in range(_ROUNDS):
        spread = NOISE * max(1.0, _WIDER * _NARROWING**number)
        matrix, vector = _normal_equations(scene, rotation, centre, spread=spread, level=level)
        step = so3.solve_batched(matrix + 1e-3 * np.eye(6), vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step[:, :3], _MOST_TURN))
        centre = centre + so3.clamp_norm(step[:, 3:], _MOST_STEP) * scene.radius
    return rotation, centre, _normal_equations(scene, rotation, centre, spread=NOISE, level=level)[0]


def _normal_equations(
    scene: Correspondences, rotation: Array, centre: Array, *, spread: float, level: float
) -> tuple[Array, Array]:
    """Normal equations of s poses: (s, 6, 6) and (s, 6), by turn and step.

    The camera is held about level, and about as high as the map's.
    """
    matrix, vector = _residual_equations(
        epipolar_residual(scene, rotation=rotation, centre=centre), spread, radius=scene.radius
    )
    where = depth_residual(scene, rotation=rotation, centre=centre)
    more = _residual_equations(where, spread * where.sigma, radius=scene.radius)
    matrix, vector = matrix + more[0], vector + more[1]
    for (sine, row), tilt in zip(so3.roll_pitch_sines(rotation), (_ROLL_SPREAD, _PITCH_SPREAD), strict=True):
        matrix[:, :3, :3] += row[:, :, None] * row[:, None, :] / tilt**2
        vector[:, :3] -= row * sine[:, None] / tilt**2
    matrix[:, 4, 4] += 1.0 / _HEIGHT_SPREAD**2
    vector[:, 4] -= (centre[:, 1] - level) / scene.radius / _HEIGHT_SPREAD**2
    return matrix, vector


def _residual_equations(
    found: EpipolarResidual | DepthResidual, spread: float | Array, *, radius: float
) -> tuple[Array, Array]:
    """Normal equations (s, 6, 6) and (s, 6) of residuals, of which the larger ones count less."""
    strength = found.in_front / (1.0 + (found.value / spread) ** 2) ** 2 / spread**2
    derivatives = found.derivatives(radius)
    weighted = derivatives * strength[:, None]
    return weighted @ np.swapaxes(derivatives, 1, 2), -(weighted @ found.value[..., None])[..., 0]


def _covariance(information: Array, radius: float) -> Array:
    """Covariance of (x, y), map pixels squared, from the information of turn and step."""
    whole = np.linalg.inv(information + 1e-9 * np.eye(6))[np.ix_([3, 5], [3, 5])] * radius**2
    flip = np.diag([1.0, -1.0])  # y is down the map, z is north
    covariance: Array = flip @ whole @ flip
    return covariance
