"""Extracts one map photo to a feature file: the unit of work of a build, run in worker processes."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.blur import outside
from webapp.core.boxes import BlurBox
from webapp.core.features.extract import extract
from webapp.core.features.table import FeatureChoice
from webapp.core.features.types import Features
from webapp.core.mapmodel.panorama import LevelView
from webapp.core.mapmodel.views import content_of_part
from webapp.core.retrieval.engines.types import PhotoEntry
from webapp.errors import IndexDamaged, MapError, PhotoError
from webapp.files.contents import connect, pointer_of
from webapp.files.localize.features import read_segment, write_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.files.localize.models import network
from webapp.files.maps.folder import photo_path
from webapp.files.photos.panorama import read_level_view
from webapp.files.photos.photo import read_facts, read_file, read_gray
from webapp.settings import Settings

_BORDER_PX = 15
"""Width of the patch around a keypoint that must not contain masked pixels."""


@dataclass(frozen=True, slots=True)
class PhotoJob:
    """Input of a worker."""

    id: int  # Id of the experience or view
    cfg: Path  # The map
    photo: str  # Path as in the map
    folder: Path  # Index folder
    choice: FeatureChoice
    settings: Settings
    # Content hashes of indexed photos of the same size, one of which may be this photo.
    indexed: tuple[str, ...] = ()
    view: LevelView | None = None  # The view to cut, if the photo is a panorama
    blurred: tuple[BlurBox, ...] = ()  # Blurred parts of any other photo, without features


@dataclass(frozen=True, slots=True)
class PhotoDone:
    """Result of one photo."""

    id: int
    # `bytes`, `mtime_ns`: Size and time of the file; 0 if it is missing.
    bytes: int = 0
    mtime_ns: int = 0
    content: str = ""  # Content hash; empty if the photo could not be read
    error: str = ""  # Why there are no features; empty on success
    # False if its features existed already, from an interrupted build or under another name.
    extracted: bool = False


def extract_photo(job: PhotoJob) -> PhotoDone:
    """Read one photo and store its features; a bad photo is a result, not an exception.

    Raises:
        StorageError: The file cannot be written.
    """
    connect(job.settings)  # each worker process connects to the storage by itself
    seen = PhotoDone(job.id, *size_and_time(job.cfg.parent / job.photo))
    try:
        data = read_file(photo_path(job.cfg, job.photo), limits=job.settings.photo)
        content = content_of_part(hashlib.sha256(data).hexdigest(), view=job.view, blurred=job.blurred)
        target = IndexFolder(job.folder).spool_path(content)
        there = content in job.indexed or _finished(target)
        if not there:
            write_segment(target, [_describe(data, content, job)])
    except (MapError, PhotoError) as error:
        return replace(seen, error=f"{error.message}; {error.hint}" if error.hint else error.message)
    return replace(seen, content=content, extracted=not there)


def extract_one(_: None, job: PhotoJob) -> PhotoDone:
    """Call `extract_photo` from `in_order`; there is no shared value."""
    return extract_photo(job)


def size_and_time(path: Path) -> tuple[int, int]:
    """Return a file's size in bytes and modification time in nanoseconds; zeros if it is missing."""
    pointer = pointer_of(path)
    if pointer is not None:
        return pointer.bytes, pointer.mtime_ns
    try:
        stat = path.stat()
    except OSError:
        return 0, 0
    return stat.st_size, stat.st_mtime_ns


def _describe(data: bytes, content: str, job: PhotoJob) -> PhotoEntry:
    settings, cut = job.settings, None
    if job.view is None:
        gray = read_gray(data, limits=settings.photo, max_side=settings.extract.max_side_px)
        fov = read_facts(data, limits=settings.photo).fov_deg
    else:
        cut = read_level_view(data, job.view, limits=settings.photo, max_side=settings.extract.max_side_px)
        gray, fov = cut.photo, cut.fov_deg
    features = extract(
        gray.pixels,
        job.choice,
        keypoints=settings.extract.keypoints,
        scale=gray.scale,
        photo_size=gray.full_size,
        network=network(job.choice.model, settings.models, weights=job.choice.weights),
    )
    if cut is not None:
        features = features.subset(_away_from_mask(features, cut.used, scale=gray.scale))
    elif job.blurred:
        height, width = gray.pixels.shape
        used = outside(job.blurred, width=width, height=height)
        features = features.subset(_away_from_mask(features, used, scale=gray.scale))
    return PhotoEntry(content, math.nan if fov is None else fov, features)


def _away_from_mask(features: Features, used: NDArray[np.bool_], *, scale: float) -> NDArray[np.int64]:
    """Return the indices of the keypoints whose patches contain no masked pixels."""
    used = cv2.erode(used.astype(np.uint8), np.ones((_BORDER_PX, _BORDER_PX), np.uint8), borderValue=1)
    height, width = used.shape
    x, y = np.rint((features.xy + 0.5) * scale - 0.5).astype(np.int64).T
    return np.flatnonzero(used[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)])


def _finished(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        read_segment(path, mapped=False)
    except IndexDamaged:
        return False
    return True
