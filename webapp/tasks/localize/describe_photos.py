"""Computes global descriptors of a map's photos, if the user has supplied a model; see `global_model`.

The vectors are stored by content hash. Only new photos are processed, and a killed run keeps its results.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.global_descriptor import GlobalDescriptor
from webapp.core.mapmodel.model import Experience
from webapp.core.mapmodel.views import content_of
from webapp.core.retrieval.global_descriptors import GlobalDescriptors
from webapp.errors import InputError, MissingPart, PhotoError
from webapp.files.contents import settle
from webapp.files.localize import global_vectors
from webapp.files.localize.global_vectors import StoredVectors
from webapp.files.localize.models import global_descriptor
from webapp.files.maps.folder import photo_path
from webapp.files.photos.panorama import cut_level_view
from webapp.files.photos.photo import read_blurred, read_file
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.localize.open_map import OpenMap

_SAVED_EVERY_S = 20.0


def describe_photos(opened: OpenMap, *, progress: Progress) -> OpenMap:
    """Update the global descriptors of a map's photos and attach them to it.

    Without a usable model nothing is done; an unusable one is reported by `progress.note`. Raises
    StorageError, Cancelled.

    Args:
        progress: With a model, a stage with one step per new photo.
    """
    try:
        network = global_descriptor(opened.settings.models)
        if network is not None:
            _update(opened, network, progress=progress)
            opened = with_stored_vectors(opened, network)
    except (InputError, MissingPart) as error:
        progress.note(f"without the global descriptor: {error}")
    return opened


def with_stored_vectors(opened: OpenMap, network: GlobalDescriptor) -> OpenMap:
    """Attach the stored global descriptors of a map's photos, if there are any."""
    stored = _stored(opened, network)
    if stored is None:
        return opened
    number = {content: row for row, content in enumerate(stored.contents)}
    # Of several photos with equal content, the index has the first.
    row = np.array([number.pop(content, -1) for content in opened.contents], np.int64)
    if (row < 0).all():
        return opened
    described = GlobalDescriptors(network, stored.vectors, row)
    return replace(opened, indexed=replace(opened.indexed, global_descriptors=described))


def paths(opened: OpenMap, network: GlobalDescriptor) -> tuple[Path, Path]:
    """Return the possible files of the vectors, next to the index folders; the last one is written."""
    name = global_vectors.file_name(network.weights)
    return opened.folder.folder.with_name(name), opened.writable.with_name(name)


def _update(opened: OpenMap, network: GlobalDescriptor, *, progress: Progress) -> None:
    """Compute and store the vectors of new photos."""
    known = _known(opened, network)
    photos = zip(opened.contents, opened.pictures, strict=True)
    todo = {content: e for content, e in photos if content and content not in known}
    progress.size(len(todo))
    if not todo:
        return
    progress.note("computing global descriptors")
    saved = time.monotonic()
    try:
        for content, experience in todo.items():
            progress.check()
            path = photo_path(opened.cfg, experience.photo)
            limits = opened.settings.photo
            vector = _describe(path, content, experience=experience, network=network, limits=limits)
            if vector is not None:
                known[content] = vector.astype(np.float16)
            progress.advance()
            if time.monotonic() > saved + _SAVED_EVERY_S:
                _store(opened, network, known)
                saved = time.monotonic()
    finally:
        if known:
            _store(opened, network, known)
    settle(paths(opened, network)[-1])


def _describe(
    path: Path,
    content: str,
    *,
    experience: Experience,
    network: GlobalDescriptor,
    limits: PhotoLimits,
) -> NDArray[np.float32] | None:
    """Compute the vector of a photo; None if the file has changed since it was indexed or is unreadable."""
    try:
        data = read_file(path, limits=limits)
        if content_of(experience, hashlib.sha256(data).hexdigest()) != content:
            return None
        pixels, view = read_blurred(data, experience.blurred, limits=limits), experience.view
        return network.describe(pixels if view is None else cut_level_view(pixels, view)[0])
    except PhotoError:
        return None


def _known(opened: OpenMap, network: GlobalDescriptor) -> dict[str, NDArray[np.float16]]:
    """Read the stored vectors of the map's photos, by content hash."""
    stored = _stored(opened, network)
    wanted = {*opened.contents}
    pairs = zip(stored.contents, stored.vectors, strict=True) if stored else ()
    return {content: vector for content, vector in pairs if content in wanted}


def _stored(opened: OpenMap, network: GlobalDescriptor) -> StoredVectors | None:
    files = paths(opened, network)
    there = (global_vectors.read(path, weights=network.weights) for path in reversed(files))
    return next((s for s in there if s is not None), None)


def _store(opened: OpenMap, network: GlobalDescriptor, known: Mapping[str, NDArray[np.float16]]) -> None:
    """Write vectors in an order that does not depend on when they were computed."""
    contents = sorted(known)
    stored = StoredVectors(contents, np.stack([known[c] for c in contents]), network.weights)
    global_vectors.write(paths(opened, network)[-1], stored)
