"""One map photo to a finished feature file: the unit of work of a build, run in worker processes."""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import threading
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path

import cv2

from webapp.core.features.extract import extract
from webapp.core.features.table import FeatureChoice
from webapp.core.index.segment import PhotoEntry
from webapp.errors import ExpMapError, IndexDamaged, PhotoError
from webapp.files.featurefile import read_segment, write_segment
from webapp.files.indexstore import IndexFolder
from webapp.files.photo import read_facts, read_gray
from webapp.settings import Settings


@dataclass(frozen=True, slots=True)
class PhotoJob:
    """What a worker needs to know.

    Attributes
    ----------
    id : int
        Of the experience.
    path : Path
        The photo file.
    folder : Path
        Of the index.
    """

    id: int
    path: Path
    folder: Path
    choice: FeatureChoice
    settings: Settings


@dataclass(frozen=True, slots=True)
class PhotoDone:
    """What became of one photo.

    Attributes
    ----------
    id : int
    bytes, mtime_ns : int
        Of the file that was read; 0 when there was none.
    content : str
        SHA-256; empty when it could not be read.
    error : str
        Why there are no features; empty when there are.
    extracted : bool
        False when an earlier, interrupted build had finished this photo.
    """

    id: int
    bytes: int = 0
    mtime_ns: int = 0
    content: str = ""
    error: str = ""
    extracted: bool = False


def start_worker() -> None:
    """Prepare a worker process: one native thread, and an end with its parent, however that ends."""
    cv2.setNumThreads(1)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def run(job: PhotoJob) -> PhotoDone:
    """Read, describe and keep one photo; a bad photo is a result, not an exception.

    Raises
    ------
    StorageError
        The disk refused.
    """
    try:
        stat = job.path.stat()
        data = job.path.read_bytes()
    except OSError as error:
        return PhotoDone(job.id, error=f"cannot be read: {error.strerror}")
    seen = PhotoDone(job.id, stat.st_size, stat.st_mtime_ns, hashlib.sha256(data).hexdigest())
    target = IndexFolder(job.folder).spool_path(seen.content)
    if _finished(target):
        return seen
    try:
        entry = _describe(data, seen.content, job)
    except PhotoError as error:
        return PhotoDone(job.id, stat.st_size, stat.st_mtime_ns, error=_sentence(error))
    write_segment(target, [entry])
    return PhotoDone(seen.id, seen.bytes, seen.mtime_ns, seen.content, extracted=True)


def _describe(data: bytes, content: str, job: PhotoJob) -> PhotoEntry:
    settings = job.settings
    gray = read_gray(data, limits=settings.photo, max_side=settings.extract.max_side_px)
    fov = read_facts(data, limits=settings.photo).fov_deg
    features = extract(
        gray.pixels,
        job.choice,
        keypoints=settings.extract.keypoints,
        scale=gray.scale,
        photo_size=gray.full_size,
    )
    return PhotoEntry(content, math.nan if fov is None else fov, features)


def _finished(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        read_segment(path)
    except IndexDamaged:
        return False
    return True


def _sentence(error: ExpMapError) -> str:
    return f"{error.message}; {error.hint}" if error.hint else error.message
