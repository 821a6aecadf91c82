"""Joins the submodels of a map into one model by the known positions of their photos (pycolmap).

The submodels were aligned with the map by their placed photos, so that all cameras share a world frame. In
it, points are triangulated again, also between photos of different submodels; cameras, points and lenses are
bundle-adjusted with the known positions as priors; and photos of no submodel are added: placed ones with a
rotation from their matches with neighbours, others by resection from points. The error limits get narrower
from round to round.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.uncertainty import AdjustedCameras, position_covariances
from webapp.files.landmarks.colmap import Model, as_model, pycolmap
from webapp.files.landmarks.match_database import LEAST_INLIERS
from webapp.files.landmarks.position_priors import PicturePositions, PositionPriors

Array = NDArray[np.float64]

_LEAST_POINTS, _FEW_POINTS = 15, 10
"""Points that a photo, or a panorama in all its views, must show: to stay in the final model, and to be
added."""

_KEPT = 0.5
"""Least share of the submodels' observations that must remain; below it, the positions contradict the photos,
or the map is not to scale."""

_ROBUST_SIGMAS, _ROBUST_PX = 3.0, 1.0
"""Scales of the robust losses: of the position priors, in standard deviations, and of the reprojection
errors."""

_SIDE_PX = 1000
"""Longer side of photos up to which keypoints are accurate to a pixel; above, the error grows with size."""

_ITERATIONS = 30

_AGREE_DEG = 8.0
"""Rotations that neighbours give a photo agree if they differ by less."""


class _Round(NamedTuple):
    """Limits of the reprojection error, in pixels, and of the angle between rays of one point, in degrees;
    and the factor by which the standard deviations of known positions are multiplied."""

    error_px: float
    angle_deg: float
    wider: float


_SUBMODELS = (_Round(16.0, 4.0, 5.0), _Round(8.0, 4.0, 2.0))
_NEIGHBOURS = (_Round(12.0, 4.0, 3.0), _Round(4.0, 2.0, 2.0))
_LAST = _Round(4.0, 2.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class AdjustJob:
    """Photos with poses on a map, and known positions.

    The world frame is the map's: pixels, x to the right, y down the image, z into the ground.
    """

    database: Path  # Database of the matches
    models: tuple[Path, ...]  # Folders of the submodels' models
    out: Path  # Folder for the joined model
    contents: tuple[str, ...]  # The n photos whose poses on the map are known from submodels
    centre: Array  # (n, 3) float64
    rotation: Array  # (n, 3, 3) float64. Camera from world.
    # Of all pictures that take part: the database also has those of photos that are no longer on the map.
    positions: PicturePositions


def adjust(job: AdjustJob) -> Model | None:
    """Join the submodels and write the model; None if the photos contradict the positions."""
    scene = _Scene(job)
    for round_ in _SUBMODELS:
        scene.refine(round_)
    for round_ in _NEIGHBOURS:
        scene.allow(round_)
        scene.add_placed()
        scene.refine(round_)
    scene.add_by_points()
    scene.refine(_LAST)
    scene.refine(_LAST)
    return scene.finish(job.out)


class _Scene:
    """The joined model while it is built."""

    def __init__(self, job: AdjustJob) -> None:
        self._job, self._colmap = job, pycolmap()
        self._database = self._colmap.Database.open(job.database)
        options = self._colmap.DatabaseCacheOptions()
        options.min_num_matches = LEAST_INLIERS
        options.image_names = set(job.positions.pictures)
        self._cache = self._colmap.DatabaseCache.create(self._database, options)
        side = np.median([max(camera.width, camera.height) for camera in self._cache.cameras.values()])
        self._pixel = max(1.0, float(side) / _SIDE_PX)
        self._priors = PositionPriors(self._colmap, cache=self._cache, positions=job.positions)
        self._placed, self._height_of = self._priors.placed, job.positions.height_of
        self._model = self._colmap.Reconstruction()
        self._model.load(self._cache)
        self._id = {image.name: id for id, image in self._model.images.items()}
        self._before = self._read_models()
        for content, centre, rotation in zip(job.contents, job.centre, job.rotation, strict=True):
            if not self._model.image(self._id[content]).has_pose:
                self._pose(self._id[content], centre, rotation)
        self._triangulation = self._colmap.IncrementalTriangulatorOptions()
        # Points seen by only two photos are kept, since positions of photos are known.
        self._triangulation.ignore_two_view_tracks = False
        self._triangulation.random_seed = 1
        self._options = self._colmap.IncrementalMapperOptions()
        self._options.abs_pose_min_num_inliers = _LEAST_POINTS
        self._options.abs_pose_refine_focal_length = self._options.abs_pose_refine_extra_params = False
        self._options.random_seed = 1
        self._mapper = self._colmap.IncrementalMapper(self._cache)
        self._mapper.begin_reconstruction(self._model)
        self.allow(_SUBMODELS[0])
        self._triangulate()

    def _read_models(self) -> int:
        """Copy the lenses from the submodels; return how many observations their photos have there."""
        posed, lenses, seen = set(self._job.contents), set[int](), 0
        for folder in self._job.models:
            model = self._colmap.Reconstruction(folder)
            for id, camera in model.cameras.items():
                if id not in lenses and id in self._model.cameras:
                    self._model.camera(id).params = camera.params
                    lenses.add(id)
            images = [model.image(id) for id in model.reg_image_ids()]
            seen += sum(image.num_points3D for image in images if image.name in posed)
        return seen

    def _pose(self, id: int, centre: Array, rotation: Array) -> None:
        image = self._model.image(id)
        pose = self._colmap.Rigid3d(self._colmap.Rotation3d(rotation), -rotation @ centre)
        self._model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
        self._model.register_frame(image.frame_id)

    def allow(self, round_: _Round) -> None:
        """Set the error limits from now on."""
        self._triangulation.create_max_angle_error = round_.angle_deg
        self._triangulation.continue_max_angle_error = round_.angle_deg
        self._options.filter_max_reproj_error = round_.error_px * self._pixel

    def refine(self, round_: _Round) -> None:
        """Adjust cameras, points and lenses, then filter the points and triangulate again."""
        self._adjust(round_.wider)
        self.allow(round_)
        self._mapper.filter_points(self._options)
        self._triangulate()
        self._mapper.filter_points(self._options)

    def _triangulate(self) -> None:
        for id in self._model.reg_image_ids():
            self._mapper.triangulate_image(self._triangulation, id)
        self._mapper.complete_and_merge_tracks(self._triangulation)
        self._mapper.retriangulate(self._triangulation)

    def _adjust(self, wider: float) -> None:
        colmap, model = self._colmap, self._model
        options = colmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.refine_sensor_from_rig = False
        options.ceres.loss_function_type = colmap.LossFunctionType.SOFT_L1
        options.ceres.loss_function_scale = _ROBUST_PX * self._pixel
        options.ceres.solver_options.max_num_iterations = _ITERATIONS
        prior_options = colmap.PosePriorBundleAdjustmentOptions()
        prior_options.ceres.prior_position_loss_function_type = colmap.LossFunctionType.SOFT_L1
        prior_options.ceres.prior_position_loss_scale = _ROBUST_SIGMAS
        self._priors.solve(model, options=options, prior_options=prior_options, wider=wider)

    def add_placed(self) -> None:
        """Add photos with known positions, those with most matches first; the rotation of each is the one on
        which most matches with neighbours agree."""
        turns = self._relative_rotations()
        waiting = {id for id in turns if self._is_placed(id)}
        while True:
            waiting = {id for id in waiting if not self._model.image(id).has_pose}
            given = {id: self._given(turns[id]) for id in waiting}
            given = {id: rotations for id, rotations in given.items() if rotations}
            if not given:
                return
            id = max(given, key=lambda id: sum(count for _, count in given[id]))
            waiting.remove(id)
            rotation, support = agreed_rotation(given[id])
            if support >= LEAST_INLIERS:
                self._add(id, rotation)

    def _is_placed(self, id: int) -> bool:
        return self._model.image(id).name in self._placed

    def _add(self, id: int, rotation: Array) -> None:
        image = self._model.image(id)
        manager = self._mapper.observation_manager
        above = self._height_of.get(image.name, 0.0)
        self._pose(id, np.append(self._placed[image.name][0], -above), rotation)
        manager.register_frame(image.frame_id)
        self._triangulate_frame(id)
        if self._points_of(image.frame_id) < _FEW_POINTS:
            manager.deregister_frame(image.frame_id)

    def _given(self, turns: Sequence[tuple[int, Array, int]]) -> list[tuple[Array, int]]:
        """List a photo's rotations by its neighbours in the model, with their numbers of matches."""
        return [
            (turn.T @ self._model.image(other).cam_from_world().rotation.matrix(), count)
            for other, turn, count in turns
            if self._model.image(other).has_pose
        ]

    def _relative_rotations(self) -> dict[int, list[tuple[int, Array, int]]]:
        """Estimate the relative rotations of pairs of photos that are not both in the model: for each photo
        the other's id, the rotation other-from-this (3, 3), and the number of matches."""
        turns: dict[int, list[tuple[int, Array, int]]] = {}
        keypoints: dict[int, Array] = {}
        for key in self._cache.correspondence_graph.image_pairs():
            pair = self._colmap.pair_id_to_image_pair(key)
            images = [self._model.image(id) for id in pair]
            if all(image.has_pose for image in images):
                continue
            for image in images:
                if image.image_id not in keypoints:
                    keypoints[image.image_id] = np.array([point.xy for point in image.points2D])
            geometry = self._database.read_two_view_geometry(*pair)
            first, second = ((image.camera, keypoints[image.image_id]) for image in images)
            if not self._colmap.estimate_two_view_geometry_pose(*first, *second, geometry):
                continue
            turn, count = geometry.cam2_from_cam1.rotation.matrix(), len(geometry.inlier_matches)
            turns.setdefault(pair[0], []).append((pair[1], turn, count))
            turns.setdefault(pair[1], []).append((pair[0], turn.T, count))
        return turns

    def add_by_points(self) -> None:
        """Add photos with unknown positions by resection from points, until no more can be added."""
        while any(self._register(id) for id in self._mapper.find_next_images(self._options, False)):
            pass

    def _register(self, id: int) -> bool:
        if self._is_placed(id):
            return False
        if not self._mapper.register_next_image(self._options, id):
            return False
        self._triangulate_frame(id)
        return True

    def _triangulate_frame(self, id: int) -> None:
        for other in self._images_of(self._model.image(id).frame_id):
            self._mapper.triangulate_image(self._triangulation, other)

    def _images_of(self, frame_id: int) -> list[int]:
        """List the images of a frame: a photo, or the views of a panorama."""
        return [data.id for data in self._model.frame(frame_id).image_ids]

    def _points_of(self, frame_id: int) -> int:
        return sum(self._model.image(id).num_points3D for id in self._images_of(frame_id))

    def finish(self, out: Path) -> Model | None:
        """Drop photos with too few points, and write the model; None if too few observations remain."""
        seen = [self._model.image(self._id[content]).num_points3D for content in self._job.contents]
        self._mapper.end_reconstruction(False)  # this removes images without a pose
        self._database.close()
        if sum(seen) < _KEPT * self._before:
            return None
        for frame in list(self._model.reg_frame_ids()):
            if self._points_of(frame) < _LEAST_POINTS:
                self._model.deregister_frame(frame)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        self._model.write(out)
        model = as_model(self._model)
        return replace(model, covariance=self._covariance(model))

    def _covariance(self, model: Model) -> Array | None:
        """Compute the position covariances (n, 2, 2) of the model's n photos on the map."""
        frames, frame = np.unique(model.frame, return_inverse=True)
        ids = [self._id[content] for content in model.contents]
        row = {id: number for number, id in enumerate(ids)}
        lenses = [self._model.image(id).camera for id in ids]
        points = list(self._model.points3D.values())
        seen = [(row[e.image_id], n) for n, point in enumerate(points) for e in point.track.elements]
        camera_row, point_row = np.array(seen, np.int64).reshape(-1, 2).T
        prior = np.full((len(frames), 3), np.inf)
        for id, sigma in self._priors.sigma_of_cameras(self._model).items():
            prior[frame[row[id]]] = sigma
        cameras = AdjustedCameras(
            frame,
            model.centre,
            model.rotation,
            np.array([lens.mean_focal_length() for lens in lenses]),
            np.array([lens.params[-1] for lens in lenses]),
            np.array([point.xyz for point in points]).reshape(-1, 3),
            camera_row,
            point_row,
        )
        found = position_covariances(cameras, keypoint_sigma_px=self._pixel, prior_sigma=prior)
        return None if found is None else found[frame]


def agreed_rotation(given: Sequence[tuple[Array, int]]) -> tuple[Array, int]:
    """Average the rotations (3, 3) on which most matches agree; also return the number of these matches."""
    rotations = np.array([rotation for rotation, _ in given])
    count = np.array([count for _, count in given])
    cosine = (np.einsum("aij,bij->ab", rotations, rotations) - 1.0) / 2.0
    near = cosine > np.cos(np.radians(_AGREE_DEG))
    support = near @ count
    most = int(support.argmax())
    left, _, right = np.linalg.svd(np.einsum("n,nij->ij", count * near[most], rotations))
    return left @ right, int(support[most])
