"""COLMAP's database (pycolmap): keypoints of photos, and the inlier matches of pairs."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.landmarks.submodels import view_rotation
from webapp.files.landmarks.colmap import pycolmap

LEAST_INLIERS = 15
"""Least number of inliers of a relative pose for two photos to count as showing the same thing."""

_TRIALS = 2000
"""Maximum RANSAC iterations for a relative pose."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredPhoto:
    id: int
    camera: Any
    # (n + k, 2) float64. Its keypoints, pixels from the outer corner of the top-left pixel, as in COLMAP:
    # those with descriptors, then those of `learned`.
    xy: NDArray[np.float64]
    descriptors: NDArray[np.uint8]  # (n, d) uint8
    learned: Features | None = None  # k keypoints, with descriptors for a matching network


@dataclass(frozen=True, slots=True, eq=False)
class ViewFeatures:
    """Keypoints of a level view of a panorama."""

    content: str  # Identifies the view, as the SHA-256 of its file identifies a photo
    features: Features
    turn_deg: int  # Clockwise rotation from the middle of the panorama
    fov_deg: float  # Horizontal field of view
    learned: Features | None = None  # For a matching network


_Lens = tuple[int, int, float]
"""Width, height and focal length, pixels."""


class MatchDatabase:
    """Keypoints of photos, and the pairs that were compared, with their inlier matches.

    Args:
        path: Created if missing; a damaged database is replaced by an empty one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._colmap = pycolmap()
        try:
            self._read()
        except RuntimeError:
            for file in (path, *path.parent.glob(f"{path.name}-*")):
                file.unlink(missing_ok=True)
            self._read()

    def _read(self) -> None:
        self._database = self._colmap.Database.open(self.path)
        self._ids = {image.name: image.image_id for image in self._database.read_all_images()}
        self._frame_of = {
            data.id: frame.frame_id for frame in self._database.read_all_frames() for data in frame.image_ids
        }
        if set(self._ids.values()) != self._frame_of.keys():
            self._database.close()
            raise RuntimeError("killed between an image and its frame: COLMAP's programs refuse it")
        keys, counts = self._database.read_two_view_geometry_num_inliers()
        self._inliers = {
            tuple(sorted(self._colmap.pair_id_to_image_pair(key))): count
            for key, count in zip(keys, counts, strict=True)
        }
        cameras = {camera.camera_id: camera for camera in self._database.read_all_cameras()}
        self._cameras: dict[_Lens, Any] = {}
        self._rigs: dict[_Lens, tuple[int, list[Any]]] = {}
        for rig in self._database.read_all_rigs():
            own = [cameras[sensor.id] for sensor in sorted(rig.sensor_ids(), key=lambda s: s.id)]
            if len(own) == 1:
                self._cameras[_lens_of(own[0])] = own[0]
            else:
                self._rigs[_lens_of(own[0])] = rig.rig_id, own

    def close(self) -> None:
        self._database.close()

    def add(
        self,
        content: str,
        features: Features,
        *,
        fov_deg: float,
        is_guessed: bool,
        learned: Features | None = None,
    ) -> StoredPhoto:
        """Add a photo unless it exists; photos of the same size and field of view share a camera.

        Args:
            fov_deg: Horizontal field of view of the upright photo.
            is_guessed: Whether `fov_deg` is a guess; otherwise the reconstruction trusts it more.
            learned: Further keypoints, for a matching network.
        """
        lens = _lens(features, fov_deg)
        if lens not in self._cameras:
            camera = self._write_camera(lens, is_guessed=is_guessed)
            rig = self._colmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            self._database.write_rig(rig, use_rig_id=True)
            self._cameras[lens] = camera
        camera = self._cameras[lens]
        if content not in self._ids:
            self._write_frame([self._write_image(content, camera)], rig_id=camera.camera_id)
        return self._stored(content, camera, features=features, learned=learned)

    def add_panorama(self, views: Sequence[ViewFeatures]) -> list[StoredPhoto]:
        """Add the level views of a panorama unless they exist.

        They are one frame of a rig, so that they share a centre and their relative rotations are known.
        """
        first = views[0]
        rig_id, cameras = self._rig(_lens(first.features, first.fov_deg), [v.turn_deg for v in views])
        if first.content not in self._ids:
            images = [self._write_image(v.content, c) for v, c in zip(views, cameras, strict=True)]
            self._write_frame(images, rig_id=rig_id)
        return [
            self._stored(v.content, c, features=v.features, learned=v.learned)
            for v, c in zip(views, cameras, strict=True)
        ]

    def _rig(self, lens: _Lens, turns_deg: Sequence[int]) -> tuple[int, list[Any]]:
        """Return the id and cameras (in the order of the views) of a lens's rig, creating it if missing."""
        if lens not in self._rigs:
            cameras = [self._write_camera(lens, is_guessed=False) for _ in turns_deg]
            rig = self._colmap.Rig(rig_id=cameras[0].camera_id)
            rig.add_ref_sensor(cameras[0].sensor_id)
            for camera, turn_deg in zip(cameras[1:], turns_deg[1:], strict=True):
                turn = self._colmap.Rotation3d(view_rotation(turn_deg - turns_deg[0]))
                rig.add_sensor(camera.sensor_id, self._colmap.Rigid3d(turn, np.zeros(3)))
            self._database.write_rig(rig, use_rig_id=True)
            self._rigs[lens] = rig.rig_id, cameras
        return self._rigs[lens]

    def _write_camera(self, lens: _Lens, *, is_guessed: bool) -> Any:
        width, height, focal = lens
        camera = self._colmap.Camera(
            model="SIMPLE_RADIAL",
            width=width,
            height=height,
            params=[focal, width / 2.0, height / 2.0, 0.0],
        )
        camera.has_prior_focal_length = not is_guessed
        camera.camera_id = self._database.write_camera(camera)
        return camera

    def _write_image(self, content: str, camera: Any) -> Any:
        image = self._colmap.Image(name=content, camera_id=camera.camera_id)
        image.image_id = self._ids[content] = self._database.write_image(image)
        return image

    def _write_frame(self, images: Sequence[Any], *, rig_id: int) -> None:
        frame = self._colmap.Frame(frame_id=images[0].image_id, rig_id=rig_id)
        for image in images:
            frame.add_data_id(image.data_id)
        self._database.write_frame(frame, use_frame_id=True)
        self._frame_of |= {image.image_id: frame.frame_id for image in images}

    def _stored(
        self, content: str, camera: Any, *, features: Features, learned: Features | None
    ) -> StoredPhoto:
        stored = stored_photo(self._ids[content], camera, features=features, learned=learned)
        xy = stored.xy.astype(np.float32)
        if not self._database.exists_keypoints(stored.id):
            self._database.write_keypoints(stored.id, xy)
        elif self._database.num_keypoints_for_image(stored.id) < len(xy):  # `learned` came later
            self._database.update_keypoints(stored.id, xy)
        return stored

    def is_compared(self, one: StoredPhoto, other: StoredPhoto) -> bool:
        """Return whether two photos were compared, now or earlier."""
        return bool(self._database.exists_two_view_geometry(one.id, other.id))

    def keep(self, one: StoredPhoto, other: StoredPhoto, *, geometry: Any) -> None:
        """Store the geometry of two photos; an empty one if they have too few inliers."""
        count = len(geometry.inlier_matches)
        found = geometry if count >= LEAST_INLIERS else self._colmap.TwoViewGeometry()
        self._database.write_two_view_geometry(one.id, other.id, found)
        if count >= LEAST_INLIERS:
            self._database.write_matches(one.id, other.id, geometry.inlier_matches)
            self._inliers[tuple(sorted((one.id, other.id)))] = count

    def joined(self, contents: Iterable[str]) -> list[str]:
        """List those photos that have inliers with another one in the database; all views of a panorama if
        one of them has, as the mapper takes the whole frame."""
        seen = {
            self._frame_of[id]
            for pair, count in self._inliers.items()
            if count >= LEAST_INLIERS
            for id in pair
        }
        return [content for content in contents if self._frame_of.get(self._ids.get(content, 0)) in seen]

    def signature(self, contents: Iterable[str]) -> str:
        """Hash these photos and the inlier counts of their pairs; 64 hexadecimal characters."""
        name_of = {id: name for name, id in self._ids.items()}
        chosen = set(contents)
        pairs = [
            (name_of[one], name_of[other], count)
            for (one, other), count in self._inliers.items()
            if {name_of[one], name_of[other]} <= chosen and count >= LEAST_INLIERS
        ]
        return hashlib.sha256(json.dumps([sorted(chosen), sorted(pairs)]).encode()).hexdigest()


def two_view_geometry(one: StoredPhoto, other: StoredPhoto, *, matches: NDArray[np.uint32]) -> Any:
    """Estimate the relative pose that most matches agree with; thread-safe."""
    colmap = pycolmap()
    if len(matches) < LEAST_INLIERS:
        return colmap.TwoViewGeometry()
    options = colmap.TwoViewGeometryOptions()
    options.min_num_inliers = LEAST_INLIERS
    options.ransac.random_seed = 1
    options.ransac.max_num_trials = _TRIALS
    estimate = colmap.estimate_calibrated_two_view_geometry
    return estimate(one.camera, one.xy, other.camera, other.xy, matches, options)


def stored_photo(id: int, camera: Any, *, features: Features, learned: Features | None = None) -> StoredPhoto:
    """Return a photo as the database has it: keypoints in COLMAP's pixel convention."""
    xy = features.xy if learned is None else np.concatenate([features.xy, learned.xy])
    return StoredPhoto(id, camera, xy.astype(np.float64) + 0.5, features.descriptors, learned)


def _lens(features: Features, fov_deg: float) -> _Lens:
    width, height = features.photo_size
    return width, height, round(width / 2.0 / math.tan(math.radians(fov_deg) / 2.0), 3)


def _lens_of(camera: Any) -> _Lens:
    return camera.width, camera.height, round(float(camera.params[0]), 3)
