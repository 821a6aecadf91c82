"""Keeps `map.cfg` and `map.json` of a library map as the database has it."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from filelock import FileLock

from webapp.core.mapmodel.model import Map
from webapp.errors import MapError, StorageError
from webapp.files.atomic import storage_error
from webapp.files.listing import DERIVED
from webapp.files.maps.cfg import format_cfg, read_cfg
from webapp.files.maps.folder import placement_path, read_map_json, write_map
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import as_map

_log = logging.getLogger(__name__)

LOCK = "export.lock"
_POLL_S = 0.005
"""An export takes about 20 ms, and people wait for it with every edit."""

INDEX_JOB = "index"


def run(library: Library, map_id: int, *, overwrite: bool = False) -> bool:
    """Write the files of a map where they are older than its records.

    Several at once take turns, and who finds the newest revision written already has nothing to do. A
    `map.cfg` that somebody else has changed is left as it is. Where photos came or went, the index is to be
    brought up to date: a job is put into the queue.

    Parameters
    ----------
    library : Library
    map_id : int
    overwrite : bool
        Write over a file that was changed from outside.

    Returns
    -------
    bool
        False when the file was changed from outside: it can be taken over or overwritten.

    Raises
    ------
    StorageError
        The disk refused; the records are safe, and the next run writes them.
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        slug = None if record is None else record.slug
    if slug is None:
        return True
    derived = library.map_folder(slug) / DERIVED
    try:
        derived.mkdir(parents=True, exist_ok=True)
        with FileLock(derived / LOCK, poll_interval=_POLL_S):
            return _export(library, map_id, cfg=library.cfg(slug), overwrite=overwrite)
    except OSError as error:
        raise storage_error(error, where=slug) from error


def follow(library: Library, map_id: int) -> None:
    """Write the files of a map after a change that is safe in the database.

    A disk that refuses is no reason to tell that the change failed: the background worker writes the files
    when it can.
    """
    try:
        run(library, map_id)
    except StorageError as error:
        _log.warning("the files of map %d are not current: %s", map_id, error)


def changed_outside(record: MapRecord, cfg: Path) -> bool:
    """Tell whether `map.cfg` is neither what was written last nor what was there before."""
    return file_sha256(cfg) not in (None, record.exported_sha256, record.previous_sha256)


def file_sha256(path: Path) -> str | None:
    """Hash a small file; None where there is none."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return None


def _export(library: Library, map_id: int, *, cfg: Path, overwrite: bool) -> bool:
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        if changed_outside(record, cfg) and not overwrite:
            return False
        if record.exported_revision >= record.revision and file_sha256(cfg) == record.exported_sha256:
            return True
        map_ = as_map(session, record)
    if map_ is None:
        return True
    _announce(library, map_id, map_, cfg=cfg)
    old = _placements(cfg) - {placement.name for placement in map_.placements} - {cfg.stem}
    write_map(cfg, map_)
    for name in old:
        placement_path(cfg, name).unlink(missing_ok=True)
    with library.database.write() as session:
        session.get_one(MapRecord, map_id).exported_revision = map_.revision
    return True


def _announce(library: Library, map_id: int, map_: Map, *, cfg: Path) -> None:
    """Note what is going to be written: a writer that is killed leaves the old file or the new one.

    The revision is noted only after the files are written, so that the next run finishes what was begun.
    """
    there, other_photos = file_sha256(cfg), _photos(cfg) != {(e.id, e.photo) for e in map_.experiences}
    with library.database.write() as session:
        record = session.get_one(MapRecord, map_id)
        record.exported_sha256 = hashlib.sha256(format_cfg(map_)).hexdigest()
        record.previous_sha256 = there
        if other_photos:
            jobs.enqueue(session, INDEX_JOB, map_id=map_id)


def _photos(cfg: Path) -> set[tuple[int, str]]:
    """Ids and photos in a `.cfg`; none where there is no readable one."""
    try:
        return {(e.id, e.photo) for e in read_cfg(cfg).map.experiences}
    except MapError:
        return set()


def _placements(cfg: Path) -> set[str]:
    """Names of the placements that are there; only their files are ours to delete."""
    try:
        return set(read_map_json(cfg).placements)
    except MapError:
        return set()
