"""Attaches the geometry from which a method computes positions: photo orientations, or landmarks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from webapp.core.landmarks.cloud import AlignedCloud
from webapp.errors import UsageError
from webapp.files import contents
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud
from webapp.files.landmarks.colmap import SUBMODELS_FILE, read_submodels
from webapp.progress import Progress
from webapp.tasks.landmarks.control_points import PhotoLenses, georegister_all
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.localize.open_map import OpenMap


def prepare_geometry(opened: OpenMap, *, progress: Progress) -> OpenMap:
    """Attach the geometry that a method needs: landmarks, or the orientations of the map's photos.

    Raises:
        UsageError: The method is `landmarks`, and the map has none that can be used.
        StorageError, Cancelled
    """
    if opened.method == "landmarks":
        return with_landmarks(opened, progress=progress)
    return orient_map.estimate_orientations(opened, progress=progress)


def with_stored_geometry(opened: OpenMap) -> OpenMap:
    """Attach the geometry that is stored, without updating it.

    Raises:
        UsageError: See `prepare_geometry`.
    """
    if opened.method == "landmarks":
        return with_landmarks(opened, progress=Progress())
    return orient_map.with_orientations(opened, orient_map.newest(opened))


def paths(opened: OpenMap) -> list[Path]:
    """Return the files of the landmarks, if the method uses them."""
    return [landmarks_folder(opened.cfg) / CLOUD_FILE] if opened.method == "landmarks" else []


def with_landmarks(opened: OpenMap, *, progress: Progress) -> OpenMap:
    """Register the landmark cloud of a map with its photos, and attach it.

    Raises:
        UsageError: There is no cloud, or it is of an incompatible version.
    """
    folder = landmarks_folder(opened.cfg)
    aligned = align_landmarks(opened, folder)
    if aligned is None:
        is_there = contents.is_there(folder / CLOUD_FILE)
        raise UsageError(
            "the landmarks of the map are of another version" if is_there else "the map has no landmarks",
            where=str(opened.cfg),
            hint="run expmap landmarks build on it",
        )
    missing = len({content for content in opened.contents if content} - set(aligned.cloud.contents))
    if missing:
        progress.note(
            f"{missing} photos of the map show no landmarks; where they are new, run expmap landmarks build"
        )
    return replace(opened, landmarks=aligned)


def align_landmarks(opened: OpenMap, folder: Path) -> AlignedCloud | None:
    """Register a cloud with the current photo positions; None if the folder has no compatible one."""
    stored, submodels = read_cloud(folder / CLOUD_FILE), read_submodels(folder / SUBMODELS_FILE)
    if stored is None or submodels is None or stored.key != submodels.cloud_key:
        return None
    number = {content: n for n, content in reversed([*enumerate(opened.contents)]) if content}
    map_photo = np.array([number.get(content, -1) for content in submodels.contents], np.int64)
    photos = [opened.pictures[n] if n >= 0 else None for n in map_photo.tolist()]
    described = landmarks_folder(opened.cfg)  # the features are here, also for a partial reconstruction
    lenses = PhotoLenses(described, stored.cloud, dict(enumerate(submodels.contents)))
    results = georegister_all(submodels.submodels, photos, the_map=opened.map, lenses=lenses)
    aligned = tuple(result.aligned for result in results)
    return AlignedCloud(stored.cloud, stored.key, map_photo, submodels.submodels, aligned)
