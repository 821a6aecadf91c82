"""Photos of a map as pycolmap compares them: its database of matches, its models, and what comes of them.

The database is SQLite and holds what is finished, so that whoever is killed goes on there; photos are called
by their content in it. pycolmap is the extra `sfm`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.landmarks.joints import rigid_parts
from webapp.core.landmarks.pieces import RigidPiece
from webapp.errors import IndexDamaged
from webapp.extras import extra
from webapp.files.atomic import storage_error
from webapp.files.localize.arrays import read_arrays, write_arrays

LEAST_INLIERS = 15
"""Matches that agree with one relative pose, below which two photos are not taken to see the same."""

_TRIALS = 2000
"""Of the random sampling of a relative pose."""

PIECES_FILE = "pieces.arrays"
_FORMAT = 2


def pycolmap() -> ModuleType:
    """Import pycolmap, without its log: that photos cannot be joined is a result.

    Raises
    ------
    MissingPart
        The extra `sfm` is not installed.
    """
    with extra("sfm"):
        import pycolmap as module
    module.logging.minloglevel = int(module.logging.FATAL)
    return module


@dataclass(frozen=True, slots=True, eq=False)
class StoredPhoto:
    """A photo in the database.

    Attributes
    ----------
    xy : (n, 2) float64
        Its keypoints, pixels from the outer corner of the top-left one, as COLMAP counts them.
    descriptors : (n, d) uint8
    """

    id: int
    camera: Any
    xy: NDArray[np.float64]
    descriptors: NDArray[np.uint8]


class MatchDatabase:
    """Keypoints of photos, and which pairs were compared, with what they have in common.

    Parameters
    ----------
    path : Path
        Is made where there is none. One that is damaged is made anew.
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
        keys, counts = self._database.read_two_view_geometry_num_inliers()
        self._inliers = {
            tuple(sorted(self._colmap.pair_id_to_image_pair(key))): count
            for key, count in zip(keys, counts, strict=True)
        }
        self._cameras = {_camera_key(c): c for c in self._database.read_all_cameras()}

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def add(self, content: str, features: Features, *, fov_deg: float, is_guessed: bool) -> StoredPhoto:
        """Add a photo, unless it is there; photos of one size and field of view have one camera.

        Parameters
        ----------
        fov_deg : float
            Horizontal, of the upright photo.
        is_guessed : bool
            Whether it is a guess; otherwise the reconstruction trusts it more.
        """
        width, height = features.photo_size
        focal = width / 2.0 / math.tan(math.radians(fov_deg) / 2.0)
        key = (width, height, round(focal, 3))
        if key not in self._cameras:
            camera = self._colmap.Camera(
                model="SIMPLE_RADIAL",
                width=width,
                height=height,
                params=[round(focal, 3), width / 2.0, height / 2.0, 0.0],
            )
            camera.has_prior_focal_length = not is_guessed
            camera.camera_id = self._database.write_camera(camera)
            rig = self._colmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            self._database.write_rig(rig, use_rig_id=True)
            self._cameras[key] = camera
        camera, xy = self._cameras[key], features.xy.astype(np.float64) + 0.5
        if content not in self._ids:
            image = self._colmap.Image(name=content, camera_id=camera.camera_id)
            image.image_id = self._database.write_image(image)
            frame = self._colmap.Frame(frame_id=image.image_id, rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            self._database.write_frame(frame, use_frame_id=True)
            self._ids[content] = image.image_id
        if not self._database.exists_keypoints(self._ids[content]):
            self._database.write_keypoints(self._ids[content], xy.astype(np.float32))
        return StoredPhoto(self._ids[content], camera, xy, features.descriptors)

    def is_compared(self, one: StoredPhoto, other: StoredPhoto) -> bool:
        """Return whether two photos were compared, now or earlier."""
        return bool(self._database.exists_two_view_geometry(one.id, other.id))

    def verify(self, one: StoredPhoto, other: StoredPhoto, *, matches: NDArray[np.uint32]) -> Any:
        """Find the relative pose that most matches agree with; safe in several threads at once."""
        options = self._colmap.TwoViewGeometryOptions()
        options.min_num_inliers = LEAST_INLIERS
        options.ransac.random_seed = 1
        options.ransac.max_num_trials = _TRIALS
        if len(matches) < LEAST_INLIERS:
            return self._colmap.TwoViewGeometry()
        estimate = self._colmap.estimate_calibrated_two_view_geometry
        return estimate(one.camera, one.xy, other.camera, other.xy, matches, options)

    def keep(self, one: StoredPhoto, other: StoredPhoto, *, geometry: Any) -> None:
        """Keep what two photos have in common, or that they have nothing in common."""
        count = len(geometry.inlier_matches)
        found = geometry if count >= LEAST_INLIERS else self._colmap.TwoViewGeometry()
        self._database.write_two_view_geometry(one.id, other.id, found)
        if count >= LEAST_INLIERS:
            self._database.write_matches(one.id, other.id, geometry.inlier_matches)
            self._inliers[tuple(sorted((one.id, other.id)))] = count

    def joined(self, contents: Iterable[str]) -> list[str]:
        """List those of the photos that see the same as another one in the database."""
        seen = {id for pair, count in self._inliers.items() if count >= LEAST_INLIERS for id in pair}
        return [content for content in contents if self._ids.get(content) in seen]

    def signature(self, contents: Iterable[str]) -> str:
        """Stand for these photos and what they have in common; 64 hexadecimal characters."""
        name_of = {id: name for name, id in self._ids.items()}
        chosen = set(contents)
        pairs = [
            (name_of[one], name_of[other], count)
            for (one, other), count in self._inliers.items()
            if {name_of[one], name_of[other]} <= chosen and count >= LEAST_INLIERS
        ]
        return hashlib.sha256(json.dumps([sorted(chosen), sorted(pairs)]).encode()).hexdigest()


def _camera_key(camera: Any) -> tuple[int, int, float]:
    return camera.width, camera.height, round(float(camera.params[0]), 3)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A model that the mapper made; n photos.

    Attributes
    ----------
    contents : list of str
        SHA-256 of the photos' files.
    centre : (n, 3) float64
    rotation : (n, 3, 3) float64
        Camera from world.
    shared : (n, n) int32
        Points of the model that two photos both see.
    """

    contents: list[str]
    centre: NDArray[np.float64]
    rotation: NDArray[np.float64]
    shared: NDArray[np.int32]


def as_model(reconstruction: Any) -> Model:
    """Read what is wanted of a pycolmap reconstruction."""
    images = sorted((reconstruction.image(i) for i in reconstruction.reg_image_ids()), key=lambda i: i.name)
    number = {image.image_id: row for row, image in enumerate(images)}
    shared = np.zeros((len(images), len(images)), np.int32)
    for point in reconstruction.points3D.values():
        seen = sorted({number[element.image_id] for element in point.track.elements})
        shared[np.ix_(seen, seen)] += 1
    np.fill_diagonal(shared, 0)
    return Model(
        [image.name for image in images],
        np.array([image.projection_center() for image in images]).reshape(-1, 3),
        np.array([image.cam_from_world().rotation.matrix() for image in images]).reshape(-1, 3, 3),
        shared,
    )


def export_model(
    source: Path, out: Path, *, names: Mapping[str, str], binary: bool = False
) -> tuple[int, int]:
    """Write a model for other programs: COLMAP's text or binary files, and its points as PLY.

    Parameters
    ----------
    source : Path
        Folder of a model as the mapper wrote it, whose photos are called by their content.
    out : Path
        Folder; is made when missing.
    names : mapping of str to str
        What the photos are called instead.

    Returns
    -------
    photos, points : int

    Raises
    ------
    StorageError
    """
    model = pycolmap().Reconstruction(source)
    for image in model.images.values():
        image.name = names.get(image.name, image.name)
    try:
        out.mkdir(parents=True, exist_ok=True)
        (model.write_binary if binary else model.write_text)(out)
        model.export_PLY(out / "points.ply")
    except OSError as error:
        raise storage_error(error, where=str(out)) from error
    return model.num_reg_images(), model.num_points3D()


@dataclass(frozen=True, slots=True, eq=False)
class StoredPieces:
    """Pieces of a reconstruction, whose photos are numbers in `contents`.

    Attributes
    ----------
    key : str
        Stands for the matches that they were made of.
    adjusted : str
        Stands for the known positions that they were adjusted by; empty where they were not.
    """

    pieces: tuple[RigidPiece, ...]
    contents: tuple[str, ...]
    key: str
    adjusted: str = ""

    @property
    def cloud_key(self) -> str:
        """Stands for their points."""
        return self.key + self.adjusted


def split_models(folders: Iterable[Path], stored: StoredPieces) -> list[tuple[Path, RigidPiece]]:
    """Find for each piece the folder of the model that it was cut from, and how it was cut.

    Raises
    ------
    IndexDamaged
        One of them is gone.
    """
    number = {content: n for n, content in enumerate(stored.contents)}
    wanted = {frozenset(piece.photo.tolist()): n for n, piece in enumerate(stored.pieces)}
    found: dict[int, tuple[Path, RigidPiece]] = {}
    for folder in folders:
        model = as_model(pycolmap().Reconstruction(folder))
        for part in rigid_parts(model.shared):
            photo = np.array([number.get(model.contents[i], -1) for i in part], np.int64)
            piece = wanted.get(frozenset(photo.tolist()))
            if piece is not None:
                found.setdefault(piece, (folder, RigidPiece(photo, model.centre[part], model.rotation[part])))
    if len(found) < len(wanted):
        raise IndexDamaged("a model is gone from the disk", hint="run expmap landmarks build again")
    return [found[n] for n in range(len(stored.pieces))]


def write_pieces(path: Path, stored: StoredPieces) -> None:
    """Replace the file.

    Raises
    ------
    StorageError
    """
    pieces: Sequence[RigidPiece] = stored.pieces
    start = np.cumsum([0, *(len(piece) for piece in pieces)])
    arrays = {
        "start": start.astype(np.int64),
        "photo": np.concatenate([np.zeros(0, np.int64), *(p.photo for p in pieces)]),
        "centre": np.concatenate([np.zeros((0, 3)), *(p.centre for p in pieces)]),
        "rotation": np.concatenate([np.zeros((0, 3, 3)), *(p.rotation for p in pieces)]),
        "error_rate": np.array([p.error_rate for p in pieces], np.float64),
    }
    meta = {
        "format": _FORMAT,
        "key": stored.key,
        "adjusted": stored.adjusted,
        "contents": list(stored.contents),
    }
    write_arrays(path, arrays, meta=meta)


def read_pieces(path: Path) -> StoredPieces | None:
    """Read the file; None when there is none that this program can use, so that it is made again."""
    try:
        arrays, meta = read_arrays(path, mapped=False)
        if meta["format"] != _FORMAT:
            return None
        start = arrays["start"].tolist()
        rates = arrays["error_rate"].tolist()
        pieces = tuple(
            RigidPiece(arrays["photo"][a:b], arrays["centre"][a:b], arrays["rotation"][a:b], rate)
            for a, b, rate in zip(start[:-1], start[1:], rates, strict=True)
        )
        return StoredPieces(pieces, tuple(meta["contents"]), str(meta["key"]), str(meta["adjusted"]))
    except (IndexDamaged, KeyError):
        return None
