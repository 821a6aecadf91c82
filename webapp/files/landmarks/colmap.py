"""Reconstructions of a map by pycolmap (the extra `sfm`): models, their export, and submodels on disk.

The database of matches is SQLite and keeps finished pairs, so that a killed process can resume; in it and in
the models, photos are named by their content.
"""

from __future__ import annotations

import ctypes
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.submodels import Submodel, rigid_parts
from webapp.errors import IndexDamaged
from webapp.extras import extra
from webapp.files.atomic import storage_error
from webapp.files.localize.arrays import read_arrays, write_arrays

SUBMODELS_FILE, RIGID_FILE = "pieces.arrays", "rigid.arrays"
"""The submodels in use, and those before they were joined by known positions."""

_FORMAT = 5

_MOST_OF_SIGACTION = 512
"""More bytes than the C library's `struct sigaction` has on any platform."""


def pycolmap() -> ModuleType:
    """Import pycolmap and silence its log: a failure to join photos is a normal result."""
    with extra("sfm"), _termination_kept():
        import pycolmap as module
    module.logging.minloglevel = int(module.logging.FATAL)
    return module


@contextmanager
def _termination_kept() -> Iterator[None]:
    """Keep the process's SIGTERM handler: that of pycolmap's log prints a stack trace and exits at once.

    pycolmap is also imported in threads, where Python's own `signal.signal` cannot be called.
    """
    if sys.platform == "win32" or "pycolmap" in sys.modules:
        yield
        return
    libc, action = ctypes.CDLL(None), ctypes.create_string_buffer(_MOST_OF_SIGACTION)
    libc.sigaction(signal.SIGTERM, None, action)
    try:
        yield
    finally:
        libc.sigaction(signal.SIGTERM, action, None)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A model made by the mapper; n photos."""

    contents: list[str]  # SHA-256 of the photos' files
    centre: NDArray[np.float64]  # (n, 3) float64
    rotation: NDArray[np.float64]  # (n, 3, 3) float64. Camera from world.
    shared: NDArray[np.int32]  # (n, n) int32. Numbers of points that two photos both see.
    frame: NDArray[np.int64]  # (n,) int64. Ids of their frames; the views of a panorama share one.
    # (n, 2, 2) float64 or None. Of the centres along the first two axes, for a model that was adjusted to
    # known positions.
    covariance: NDArray[np.float64] | None = None

    def parts(self) -> list[NDArray[np.int64]]:
        """Split its photos into rigid parts; see `rigid_parts`."""
        return rigid_parts(self.shared, frame=self.frame)


def as_model(reconstruction: Any) -> Model:
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
        np.array([image.frame_id for image in images], np.int64),
    )


def export_model(
    source: Path, out: Path, *, names: Mapping[str, str], binary: bool = False, only_named: bool = False
) -> tuple[int, int]:
    """Write a model for other programs: COLMAP's text or binary files, and its points as PLY.

    Raises StorageError.

    Args:
        source: Folder of a model written by the mapper, whose photos are named by their content.
        out: Folder; created if missing.
        names: Names for the photos in the export, by content.
        only_named: Whether to leave out photos without a name, and points that only they show.

    Returns:
        photos, points:
    """
    try:
        model = pycolmap().Reconstruction(source)
    except (RuntimeError, ValueError) as error:
        raise IndexDamaged(
            "a model cannot be read", where=source.name, hint="if it is being computed, try again later"
        ) from error
    if only_named:
        kept = {image.frame_id for image in model.images.values() if image.name in names}
        for frame in set(model.reg_frame_ids()) - kept:
            model.deregister_frame(frame)
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
class StoredSubmodels:
    """Submodels of a reconstruction, whose photos are indices into `contents`."""

    submodels: tuple[Submodel, ...]
    contents: tuple[str, ...]
    key: str  # Identifies the matches from which they were computed
    adjusted: str = ""  # Identifies the known positions by which joining was tried; empty where it was not
    # Why joining failed; empty where it succeeded: then the first submodel is the joined one.
    problem: str = ""

    @property
    def cloud_key(self) -> str:
        """Identifies their points."""
        return self.key + self.adjusted


def write_submodels(path: Path, stored: StoredSubmodels) -> None:
    """Replace the file. Raises StorageError."""
    submodels: Sequence[Submodel] = stored.submodels
    start = np.cumsum([0, *(len(submodel) for submodel in submodels)])
    arrays = {
        "start": start.astype(np.int64),
        "photo": np.concatenate([np.zeros(0, np.int64), *(p.photo for p in submodels)]),
        "centre": np.concatenate([np.zeros((0, 3)), *(p.centre for p in submodels)]),
        "rotation": np.concatenate([np.zeros((0, 3, 3)), *(p.rotation for p in submodels)]),
        "error_rate": np.array([p.error_rate for p in submodels], np.float64),
        "covariance": np.concatenate([np.zeros((0, 2, 2)), *(_covariance(p) for p in submodels)]),
        "left_out": np.concatenate([np.zeros((0, 3)), *(_left_out(p) for p in submodels)]),
    }
    meta = {
        "format": _FORMAT,
        "key": stored.key,
        "adjusted": stored.adjusted,
        "problem": stored.problem,
        "contents": list(stored.contents),
    }
    write_arrays(path, arrays, meta=meta)


def read_submodels(path: Path) -> StoredSubmodels | None:
    """Read the file; None if it is missing or unusable, so that it is recomputed."""
    try:
        arrays, meta = read_arrays(path, mapped=False)
        if meta["format"] != _FORMAT:
            return None
        start = arrays["start"].tolist()
        rates = arrays["error_rate"].tolist()
        covariance, left_out = arrays["covariance"], arrays["left_out"]
        submodels = tuple(
            Submodel(
                arrays["photo"][a:b],
                arrays["centre"][a:b],
                arrays["rotation"][a:b],
                rate,
                None if np.isnan(covariance[a:b]).all() else covariance[a:b],
                None if np.isinf(left_out[a:b]).all() else left_out[a:b],
            )
            for a, b, rate in zip(start[:-1], start[1:], rates, strict=True)
        )
        texts = (str(meta[name]) for name in ("key", "adjusted", "problem"))
        return StoredSubmodels(submodels, tuple(meta["contents"]), *texts)
    except (IndexDamaged, KeyError):
        return None


def _covariance(submodel: Submodel) -> NDArray[np.float64]:
    """Return the covariances of a submodel; NaN where it has none."""
    return np.full((len(submodel), 2, 2), np.nan) if submodel.covariance is None else submodel.covariance


def _left_out(submodel: Submodel) -> NDArray[np.float64]:
    """Return where photos are without their positions; infinite where these were not left out."""
    return np.full((len(submodel), 3), np.inf) if submodel.left_out is None else submodel.left_out
