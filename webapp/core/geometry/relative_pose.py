"""Geometric verification: relative pose of two cameras that saw the same scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import poselib
from numpy.typing import NDArray

from webapp.core.geometry.estimate import NoPose

MIN_MATCHES = 8
"""Five are enough for an essential matrix; fewer than eight agree by chance."""

_MAX_EPIPOLAR_ERROR = 0.0025
"""Largest distance of an inlier from its epipolar line, as a share of the longer side of the photo."""

INLIER_SCALE = 35.0
"""Inliers beyond chance at which two out of three poses are right."""

CHANCE_INLIERS = 6.0
"""Inliers that any pair of photos has by chance."""

_CHANCE_SHARE, _SURE_SHARE = 0.15, 0.5
"""Share of the matches that agree on some pose by chance, and share from which on it is not by chance."""

_WILD_PARALLAX = math.radians(20.0)
"""Poses with more parallax are probably wrong: their rotation does not align the rays."""

_RANSAC = {"max_iterations": 100, "min_iterations": 50, "seed": 0}
_BUNDLE = {"max_iterations": 5}


def beyond_chance(share: float) -> float:
    """Return how far a share of the matches that agree is from chance, 0, to certainty, 1."""
    return min(1.0, max(0.0, (share - _CHANCE_SHARE) / (_SURE_SHARE - _CHANCE_SHARE)))


@dataclass(frozen=True, slots=True)
class Camera:
    """An upright photo's camera: a pinhole in its centre, square pixels."""

    # `width`, `height`: Pixels.
    width: int
    height: int
    fov_deg: float  # Horizontal field of view

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width / 2.0 / math.tan(math.radians(self.fov_deg) / 2.0)

    def ray_sigma(self, sigma_px: float, *, extract_side_px: float) -> float:
        """Convert the noise of keypoints to that of their rays at depth 1.

        Args:
            sigma_px: Standard deviation, pixels of the photo as extracted.
            extract_side_px: Photos are scaled down to this longer side before keypoints are detected.
        """
        scale = min(1.0, extract_side_px / max(self.width, self.height))
        return sigma_px / (self.focal_px * scale)

    def rays(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert (n, 2) pixels to (n, 3) rays: x right, y down, z forward and 1."""
        centre = np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])
        return np.column_stack([(xy - centre) / self.focal_px, np.ones(len(xy))])


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """Relative pose of the query's camera and a map photo's.

    Rotation and translation are three-dimensional; `bearing` assumes that both cameras are level.
    """

    # Direction from the query to the map photo's camera, radians clockwise from the query's viewing
    # direction, -pi to pi.
    bearing: float
    # Median angle between the rays of a match after undoing the rotation, radians. If it is small, the
    # baseline is short compared with the depths, and the bearing is unreliable.
    parallax: float
    inlier: NDArray[np.bool_]  # (n,) bool. Which matches agree.
    rotation: NDArray[np.float64]  # (3, 3) float64. Map photo's camera from the query's.
    # (3,) float64. Direction from the map photo's camera to the query's, in the map photo's frame.
    translation: NDArray[np.float64]

    @property
    def inliers(self) -> int:
        """Count the matches that agree."""
        return int(self.inlier.sum())

    @property
    def trust(self) -> float:
        """Trust in the pose, 0 to 1."""
        enough = 1.0 - math.exp(-max(0.0, self.inliers - CHANCE_INLIERS) / INLIER_SCALE)
        common = beyond_chance(self.inliers / len(self.inlier))
        return enough * common / (1.0 + (self.parallax / _WILD_PARALLAX) ** 4)

    def rotated(self, turn: NDArray[np.float64]) -> RelativePose:
        """Return the pose in another frame of the query's camera; (3, 3) `turn` maps the old to the new."""
        rotation = self.rotation @ turn.T
        return replace(self, bearing=_bearing(rotation, self.translation), rotation=rotation)


def relative_pose(
    query_xy: NDArray[np.float32], photo_xy: NDArray[np.float32], *, query: Camera, photo: Camera
) -> RelativePose | NoPose:
    """Estimate the relative pose of two photos by the five-point method in a RANSAC (PoseLib).

    Args:
        query_xy, photo_xy: (n, 2) float32. Matched points, pixels of the upright photos.
    """
    if len(query_xy) < MIN_MATCHES:
        return NoPose(f"{len(query_xy)} matches, {MIN_MATCHES} needed")
    longer = max(query.width, query.height)
    # scale both photos to the query's size, so that one tolerance in pixels fits both
    ratio = longer / max(photo.width, photo.height)
    scaled = Camera(round(photo.width * ratio), round(photo.height * ratio), photo.fov_deg)
    ours = query_xy.astype(np.float64)
    theirs = (photo_xy.astype(np.float64) + 0.5) * ratio - 0.5
    options = {**_RANSAC, "max_epipolar_error": _MAX_EPIPOLAR_ERROR * longer}
    pose, info = poselib.estimate_relative_pose(
        ours, theirs, _as_poselib(query), _as_poselib(scaled), options, _BUNDLE
    )
    inlier = np.asarray(info["inliers"], bool)
    if inlier.sum() < MIN_MATCHES:
        return NoPose(f"{int(inlier.sum())} inliers, {MIN_MATCHES} needed")
    rotation, shift = np.asarray(pose.R), np.asarray(pose.t)
    turned = query.rays(ours[inlier]) @ rotation.T
    return RelativePose(
        bearing=_bearing(rotation, shift),
        parallax=_median_angle(turned, scaled.rays(theirs[inlier])),
        inlier=inlier,
        rotation=rotation,
        translation=shift / np.linalg.norm(shift),
    )


def _bearing(rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> float:
    to_photo = -rotation.T @ translation
    return math.atan2(to_photo[0], to_photo[2])


def _median_angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    cosine = (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _as_poselib(camera: Camera) -> dict[str, object]:
    centre = [(camera.width - 1) / 2.0, (camera.height - 1) / 2.0]
    return {
        "model": "SIMPLE_PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [camera.focal_px, *centre],
    }
