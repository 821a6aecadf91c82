"""Bundle adjustment of a piece with known positions of some of its photos (pycolmap)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.similarity import Similarity
from webapp.files.landmarks.colmap import Model, as_model, pycolmap

_ROBUST_SIGMAS = 3.0
"""Deviation from a known position at which it begins to count less: it may be wrong."""

_ROBUST_PX = 1.0
"""The same of a keypoint from where its point is projected."""

_WORSE, _WORSE_PX = 1.3, 0.2
"""Keypoints that are that much farther from their points than before say that the positions are wrong, or
that the map is not to scale."""

_ITERATIONS, _ROUNDS = 50, 6
"""Of each round. While positions are farther off than they are exact, they count as if they were as inexact:
a model that bends comes to them step by step, and what is wrong among them stays an outlier."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustJob:
    """A piece, and what is known of it.

    Attributes
    ----------
    source, out : Path
        Folders of the model that holds the piece, and for that of the piece alone.
    contents : tuple of str
        Photos of the piece.
    similarity : Similarity
        From the world of the model to that of the positions.
    known : tuple of str
        Photos whose positions are known, k of them.
    at, sigma : (k, 3) float64
        Where, and the standard deviation along each axis.
    """

    source: Path
    out: Path
    contents: tuple[str, ...]
    similarity: Similarity
    known: tuple[str, ...]
    at: NDArray[np.float64]
    sigma: NDArray[np.float64]


def adjust(job: AdjustJob) -> Model | None:
    """Adjust a piece in the world of the positions, and write it; None where its photos contradict these."""
    colmap = pycolmap()
    model = colmap.Reconstruction(job.source)
    kept = set(job.contents)
    for image in list(model.images.values()):
        if image.name not in kept and image.has_pose:
            model.deregister_frame(image.frame_id)
    moved = job.similarity
    model.transform(colmap.Sim3d(moved.scale, colmap.Rotation3d(moved.rotation), moved.shift))
    by_name = {model.image(id).name: model.image(id) for id in model.reg_image_ids()}
    before = _error_px(model)
    images = [by_name[content] for content in job.known]
    beacons = _add_beacons(colmap, model, job.at)
    for _ in range(_ROUNDS):
        off = np.array([image.projection_center() for image in images]) - job.at
        wider = max(1.0, float(np.median(np.abs(off) / job.sigma, axis=0).max()))
        priors = [
            _prior(colmap, image, at=at, sigma=wider * sigma)
            for image, at, sigma in zip(images, job.at, job.sigma, strict=True)
        ]
        if not _solve(colmap, model, [*priors, *(prior for _, prior in beacons)]):
            return None
        if wider == 1.0:
            break
    for frame, _ in beacons:
        model.deregister_frame(frame)
    if _error_px(model) > _WORSE * before + _WORSE_PX:
        return None
    job.out.mkdir(parents=True, exist_ok=True)
    model.write(job.out)
    return as_model(model)


def _add_beacons(colmap: Any, model: Any, at: NDArray[np.float64]) -> list[tuple[int, Any]]:
    """Add cameras that see nothing, at known corners of a tetrahedron; returns their frames and priors.

    Before it adjusts, pycolmap fits a similarity to the known positions, and refuses those of cameras that
    are all equally high. Beacons are off that plane, and as the model is where it should be they say so.
    """
    middle, extent = at.mean(0), max(float(np.ptp(at, axis=0).max()), 1.0)
    camera = next(iter(model.cameras))
    image_id, found = max(model.images), []
    for corner in [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]:
        image_id += 1
        centre = middle + extent * np.array(corner)
        image = colmap.Image(name=f"beacon {image_id}", camera_id=camera, image_id=image_id)
        model.add_image_with_trivial_frame(image, colmap.Rigid3d(colmap.Rotation3d(), -centre))
        image = model.image(image_id)
        found.append((image.frame_id, _prior(colmap, image, at=centre, sigma=np.full(3, extent / 100.0))))
    return found


def _prior(colmap: Any, image: Any, *, at: NDArray[np.float64], sigma: NDArray[np.float64]) -> Any:
    return colmap.PosePrior(
        pose_prior_id=image.image_id,
        corr_data_id=image.data_id,
        position=at,
        position_covariance=np.diag(sigma**2),
        coordinate_system=colmap.PosePriorCoordinateSystem.CARTESIAN,
    )


def _error_px(model: Any) -> float:
    """Median distance of keypoints from where their points are projected."""
    model.update_point_3d_errors()
    return float(np.median([point.error for point in model.points3D.values()]))


def _solve(colmap: Any, model: Any, priors: Sequence[Any]) -> bool:
    options = colmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = colmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = _ROBUST_PX
    options.ceres.solver_options.max_num_iterations = _ITERATIONS
    prior_options = colmap.PosePriorBundleAdjustmentOptions()
    prior_options.ceres.prior_position_loss_function_type = colmap.LossFunctionType.CAUCHY
    prior_options.ceres.prior_position_loss_scale = _ROBUST_SIGMAS
    config = colmap.BundleAdjustmentConfig()
    for id in model.reg_image_ids():
        config.add_image(id)
    adjuster = colmap.create_pose_prior_bundle_adjuster(options, prior_options, config, list(priors), model)
    return bool(adjuster.solve().is_solution_usable())
