"""Covariances of camera positions, from the observed points and the known positions.

The normal equations of the bundle adjustment, with the points eliminated (Schur complement), are inverted:
B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000. Intrinsics
are taken as known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.absolute_pose import projection_jacobian
from webapp.extras import extra

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

MOST_CAMERAS = 1500
"""Largest number of frames: more would need too much memory, over 1.5 GB."""

_FARTHEST = 10.0
"""Prior standard deviation of a point, as a multiple of the distance to its nearest camera."""

_DAMPING = 1e-9
"""Added to the normalised diagonal: undetermined parameters become very uncertain, not infinitely."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedCameras:
    """Cameras and their observations: n cameras on f frames, m points, o observations."""

    frame: Rows  # (n,) int64. Frame of each camera, which moves as one: a photo, or all views of a panorama.
    centre: Array  # (n, 3) float64
    rotation: Array  # (n, 3, 3) float64. Camera from world.
    # `focal_px`, `distortion`: (n,) float64
    focal_px: Array
    distortion: Array
    point: Array  # (m, 3) float64
    # `camera_row`, `point_row`: (o,) int64. Camera and point of each observation.
    camera_row: Rows
    point_row: Rows


def position_covariances(
    cameras: AdjustedCameras, *, keypoint_sigma_px: float, prior_sigma: Array
) -> Array | None:
    """Compute the covariances of frame positions along the first two axes of the world.

    Args:
        prior_sigma: (f, 3) float64. Standard deviations of the known positions of frames, infinite where
            unknown.

    Returns:
        (f, 2, 2) float64 or None: None for no frames, for more than `MOST_CAMERAS`, and where the equations
            are singular.
    """
    count = len(prior_sigma)
    if not 0 < count <= MOST_CAMERAS:
        return None
    normal = _reduced_normal(cameras, count=count, keypoint_sigma_px=keypoint_sigma_px)
    places = 6 * np.arange(count)[:, None] + np.arange(3)
    normal[places, places] += prior_sigma**-2.0
    inverse = _inverse(normal)
    if inverse is None:
        return None
    first, second = places[:, 0], places[:, 1]
    off = inverse[second, first]  # only the lower triangle is computed
    rows = [np.stack([inverse[first, first], off], 1), np.stack([off, inverse[second, second]], 1)]
    return np.stack(rows, 1)


def _reduced_normal(cameras: AdjustedCameras, *, count: int, keypoint_sigma_px: float) -> Array:
    """Build the normal matrix (6 f, 6 f) of centres and of small rotations about them, in the world."""
    with extra("sfm"):
        from scipy.sparse import csr_matrix
    camera, point, frame = cameras.camera_row, cameras.point_row, cameras.frame[cameras.camera_row]
    away = cameras.point[point] - cameras.centre[camera]
    own = np.einsum("oij,oj->oi", cameras.rotation[camera], away)
    by_own = projection_jacobian(
        own, focal_px=cameras.focal_px[camera], distortion=cameras.distortion[camera]
    )
    by_point = by_own @ cameras.rotation[camera] / keypoint_sigma_px
    by_frame = np.concatenate([-by_point, by_point @ _turned_by(away)], 2)
    of_point = np.zeros((len(cameras.point), 3, 3))
    np.add.at(of_point, point, np.einsum("oki,okj->oij", by_point, by_point))
    nearest = np.full(len(of_point), np.inf)
    np.minimum.at(nearest, point, np.linalg.norm(away, axis=1))
    of_point += np.eye(3) / (_FARTHEST * nearest[:, None, None]) ** 2
    # with a Cholesky factor of the inverse on either side, the product below is symmetric
    half = np.linalg.cholesky(np.linalg.inv(of_point))
    joint = np.einsum("oki,okj->oij", by_frame, by_point) @ half[point]
    row = (6 * frame[:, None, None] + np.arange(6)[:, None] + np.zeros(3, np.int64)).astype(np.int32)
    column = (3 * point[:, None, None] + np.zeros((6, 1), np.int64) + np.arange(3)).astype(np.int32)
    shape = (6 * count, 3 * len(of_point))
    eliminated = csr_matrix((joint.ravel(), (row.ravel(), column.ravel())), shape=shape)
    normal: Array = (eliminated @ eliminated.T).toarray()
    np.negative(normal, out=normal)
    of_frame = np.zeros((count, 6, 6))
    np.add.at(of_frame, frame, np.einsum("oki,okj->oij", by_frame, by_frame))
    blocks = normal.reshape(count, 6, count, 6)
    each = np.arange(count)
    blocks[each, :, each, :] += of_frame
    return normal


def _turned_by(away: Array) -> Array:
    """Return the derivatives (n, 3, 3) of vectors `away` by a small rotation w, that is of w x `away`."""
    matrix = np.zeros((len(away), 3, 3))
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = away[:, 2], -away[:, 1], away[:, 0]
    matrix -= np.swapaxes(matrix, 1, 2)
    return matrix


def _inverse(normal: Array) -> Array | None:
    """Invert a symmetric matrix in place; only the lower triangle is valid. None if singular."""
    with extra("sfm"):
        from scipy.linalg import lapack
    scale = np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    normal /= scale[:, None]
    normal /= scale
    normal[np.diag_indices(len(normal))] += _DAMPING
    # LAPACK is column-major: the transpose of a symmetric matrix is the same, and avoids a copy
    factor, failed = lapack.dpotrf(normal.T, lower=1, overwrite_a=1, clean=0)
    if failed:
        return None
    inverse: Any
    inverse, failed = lapack.dpotri(factor, lower=1, overwrite_c=1)
    if failed:
        return None
    inverse /= scale[:, None]
    inverse /= scale
    found: Array = inverse
    return found
