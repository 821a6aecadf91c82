"""Computes a vector for each photo of all maps, so that searches begin with the most similar maps.

The vectors are computed from the descriptors in the maps' indexes: no features are extracted. Their basis is
trained on photos of the whole library, and again when it has grown to several times as many photos.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.features.table import FeatureChoice, choose
from webapp.core.retrieval import global_descriptors
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.global_descriptors import Basis
from webapp.errors import IndexDamaged
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.database import Writes
from webapp.store.library import Library
from webapp.store.maps import photo_vectors as stored
from webapp.store.maps.photo_vectors import StoredBasis
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.find.queue_refresh import JOB
from webapp.tasks.localize.index_location import index_bases, index_folder

LEAST_MAPS = 7
"""Minimum number of maps to train a basis: fewer stay open, with two looks each, and are all searched."""

GROWTH = 4
"""A basis is trained anew when there are this many times as many photos."""

SAMPLE_PHOTOS = 1000
"""Maximum number of photos that a basis is trained on."""

_SAVED_EVERY_S = 20.0

_log = logging.getLogger(__name__)


def features() -> FeatureChoice:
    """Return the features from which vectors are computed: those that need no model file."""
    return choose("vote", detector="sift", extractor="sift")


def describe_map(
    library: Library, map_id: int, *, settings: Settings, writes: Writes, progress: Progress
) -> None:
    """Compute vectors for the new photos of a map's index; queue the training of a basis if due.

    Raises StorageError, Cancelled.
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        there = stored.bases(session)
    if record is None:
        return
    for basis in there:
        _describe(library, record, basis=basis, settings=settings, writes=writes, progress=progress)
    if there:
        _refresh_search(library, progress)
    with library.database.read() as session:
        due = _is_basis_due(session, there)
    if due:
        with writes() as session:
            jobs.enqueue(session, JOB)


def renew_basis(library: Library, *, settings: Settings, writes: Writes, progress: Progress) -> int:
    """Train a basis, compute the vectors of the photos of all maps, and then let searches use it.

    Vectors that an interrupted run has computed are kept. Raises StorageError, Cancelled.
    """
    _refresh_search(library, progress)  # for maps from a move or an older version
    with library.database.read() as session:
        there = stored.bases(session)
        if not any(not b.ready for b in there) and not _is_basis_due(session, there):
            return _described(session, there)
    new = next((b for b in there if not b.ready), None)
    if new is None:
        basis, photos = _train(library, _all_maps(library), settings=settings, progress=progress)
        if basis is None:
            return 0
        with writes() as session:
            new = StoredBasis(stored.add_basis(session, basis, photos=photos), photos, False, basis)
    records = _all_maps(library)  # maps added later are described by their own jobs
    progress.size(len(records))
    for record in records:
        progress.note(record.name)
        _describe(library, record, basis=new, settings=settings, writes=writes, progress=progress)
        progress.advance()
    _refresh_search(library, progress)  # before searches use it
    with writes() as session:
        stored.use_basis(session, new.id)
        return stored.count_described(session, basis_id=new.id)


def _refresh_search(library: Library, progress: Progress) -> None:
    """Update the vector search of the database, if it has one."""
    database = library.database
    if database.photo_search is not None:
        with database.translated_errors():
            database.photo_search.refresh(check=progress.check)


def _all_maps(library: Library) -> Sequence[MapRecord]:
    """List all maps, also those in the bin: they are not described again when restored."""
    with library.database.read() as session:
        return session.scalars(select(MapRecord).order_by(MapRecord.id)).all()


def _is_basis_due(session: Session, there: list[StoredBasis]) -> bool:
    """Return whether to train the first basis, or a new one for a grown library."""
    has_many_maps = len(session.scalars(select(MapRecord.id).limit(LEAST_MAPS)).all()) == LEAST_MAPS
    ready = [b for b in there if b.ready]
    is_outgrown = not ready or _described(session, ready) >= GROWTH * ready[-1].photos
    return has_many_maps and is_outgrown


def _described(session: Session, there: list[StoredBasis]) -> int:
    return stored.count_described(session, basis_id=there[-1].id) if there else 0


def _describe(
    library: Library,
    record: MapRecord,
    *,
    basis: StoredBasis,
    settings: Settings,
    writes: Writes,
    progress: Progress,
) -> None:
    """Update the vectors of a map's photos."""
    with library.database.read() as session:
        before = stored.vectors(session, record.id, basis_id=basis.id)
    known: dict[str, NDArray[np.float16]] = {}
    saved = time.monotonic()
    try:
        for content, segment, number in indexed_photos(library.cfg(record.slug), settings=settings):
            progress.check()
            if content in before:
                known[content] = before[content]
                continue
            descriptors = np.asarray(segment.entry(number).features.descriptors)
            known[content] = global_descriptors.photo_vector(basis.basis, descriptors).astype(np.float16)
            if time.monotonic() > saved + _SAVED_EVERY_S:
                _keep(writes, record, basis=basis, vectors={**before, **known})
                saved = time.monotonic()
    except IndexDamaged as error:
        _log.warning("photos of the map %s are not described for searches: %s", record.slug, error)
        return
    if known.keys() != before.keys():
        _keep(writes, record, basis=basis, vectors=known)


def _keep(
    writes: Writes, record: MapRecord, *, basis: StoredBasis, vectors: dict[str, NDArray[np.float16]]
) -> None:
    with writes() as session:
        stored.keep_vectors(session, record.id, basis_id=basis.id, vectors=vectors)


def _train(
    library: Library, records: Sequence[MapRecord], *, settings: Settings, progress: Progress
) -> tuple[Basis | None, int]:
    """Train a basis on a sample of all photos; return it and the number of photos on all maps."""
    progress.note("training the descriptor of photos")
    photos = 0
    contents: set[str] = set()
    for record in records:
        own = {content for content, _, _ in _photos_of(library, record, settings=settings)}
        progress.check()
        photos += len(own)
        contents |= own
    # The smallest hashes are a random sample of all maps.
    chosen = {*sorted(contents)[:SAMPLE_PHOTOS]}
    sample: dict[str, NDArray[np.uint8]] = {}
    for record in records:
        progress.check()
        for content, segment, number in _photos_of(library, record, settings=settings):
            if content in chosen and content not in sample:
                sample[content] = np.array(segment.entry(number).features.descriptors)
    basis = (
        global_descriptors.train_basis([sample[content] for content in sorted(sample)]) if sample else None
    )
    return basis, photos


def _photos_of(
    library: Library, record: MapRecord, *, settings: Settings
) -> Iterator[tuple[str, Segment, int]]:
    """Yield the photos of a map's index; of a damaged one, as far as it can be read."""
    try:
        yield from indexed_photos(library.cfg(record.slug), settings=settings)
    except IndexDamaged as error:
        _log.warning("the index of the map %s is left out: %s", record.slug, error)


def indexed_photos(
    cfg: Path, *, settings: Settings, index: Path | None = None
) -> Iterator[tuple[str, Segment, int]]:
    """Yield the photos with descriptors of a map's index: content hash, segment, and number in the segment.

    Raises IndexDamaged.

    Args:
        index: Folder of the indexes, if not next to the map.
    """
    folder = _index(cfg, settings=settings, chosen=index)
    manifest = None if folder is None else folder.read_manifest()
    if folder is None or manifest is None:
        return
    wanted = {photo.content for photo in manifest.photos.values()}
    for record in manifest.segments:
        segment = read_segment(folder.segment_path(record.name))
        for number, content in enumerate(segment.content):
            if content in wanted and segment.first[number] < segment.first[number + 1]:
                yield content, segment, number


def _index(cfg: Path, *, settings: Settings, chosen: Path | None) -> IndexFolder | None:
    folders = (index_folder(b, features(), extract=settings.extract) for b in index_bases(cfg, chosen))
    return next((IndexFolder(f) for f in folders if (f / "manifest.json").is_file()), None)
