"""Writes synthetic landmarks of a map."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.landmarks.submodels import Submodel
from webapp.files.landmarks.cloud import CLOUD_FILE, COLOURS_FILE, StoredCloud, write_cloud, write_colours
from webapp.files.landmarks.colmap import SUBMODELS_FILE, StoredSubmodels, write_submodels
from webapp.files.part_file import sha256_of
from webapp.store.library import open_library
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.show_cloud import align_in_library
from webapp.tasks.localize.index_location import landmarks_folder

UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Camera-from-world rotation, facing the top of the image; the world is map pixels with y and z up."""

FOCAL_PX = 500.0


def write_landmarks(
    cfg: Path, names: Sequence[str], *, at: NDArray[np.float64], points: NDArray[np.float64]
) -> None:
    """Write a reconstruction in which all photos see all points.

    Parameters
    ----------
    at : (p, 2) ndarray of float64
        Positions of the photos, map pixels.
    points : (k, 3) ndarray of float64
        Map pixels, y and z up; all magenta.
    """
    photos, count = len(names), len(points)
    contents = tuple(sha256_of(cfg.parent / "photos" / name) for name in names)
    folder = landmarks_folder(cfg)
    folder.mkdir(parents=True, exist_ok=True)
    centre = np.column_stack([at[:, 0], -at[:, 1], np.zeros(photos)])
    submodel = Submodel(np.arange(photos), centre, np.tile(UP, (photos, 1, 1)))
    write_submodels(folder / SUBMODELS_FILE, StoredSubmodels((submodel,), contents, "key"))
    seen = photos * count
    cloud = LandmarkCloud(
        contents,
        points,
        np.zeros(count, np.int32),
        np.arange(photos + 1) * count,
        np.tile(np.arange(count, dtype=np.int32), photos),
        np.zeros((seen, 2), np.float32),
        np.zeros((seen, 128), np.uint8),
        np.full(photos, FOCAL_PX if count else 0.0),
        np.zeros(photos),
    )
    write_cloud(folder / CLOUD_FILE, StoredCloud(cloud, "key"))
    if count:
        write_colours(
            folder / COLOURS_FILE, np.tile(np.array([255, 0, 255], np.uint8), (count, 1)), key="key"
        )


def align_landmarks(library_folder: Path, slug: str) -> None:
    """Align the landmarks with the map instead of the worker, which may be busy."""
    library = open_library(library_folder)
    try:
        with library.database.read() as session:
            record = session.query(MapRecord).filter_by(slug=slug).one()
        align_in_library(library, record)
    finally:
        library.database.close()
