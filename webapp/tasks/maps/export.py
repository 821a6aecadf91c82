"""Writes `map.cfg` and `map.json` of library maps from the database.

The database is authoritative: an edit is acknowledged once it is committed (`Library.changing`), and the
files follow. The worker calls `export_late_maps` twice a second, so that many quick edits need one export; a
killed export is completed later. Code that reads or serves the files must call `export_map` first.
"""

from __future__ import annotations

import hashlib
import json
import logging
from pathlib import Path

from filelock import FileLock
from sqlalchemy import select

from webapp.core.mapmodel.model import Map
from webapp.errors import ExpMapError, MapError, StorageError
from webapp.files.atomic import storage_error
from webapp.files.listing import DERIVED
from webapp.files.maps.cfg import format_cfg, read_bytes
from webapp.files.maps.folder import json_path, placement_path, write_map
from webapp.files.maps.map_json import check_placement_name
from webapp.store.library import Library, has_library
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import as_map

_log = logging.getLogger(__name__)

LOCK = "export.lock"
_POLL_S = 0.005
"""Polling interval of the lock, seconds: an export takes a few hundredths of a second."""


def export_map(library: Library, map_id: int, *, overwrite: bool = False) -> bool:
    """Write the files of a map if they are older than its records.

    Concurrent exports of a map are serialised; later ones find the newest revision written already. A
    `map.cfg` that was edited outside the library is not touched.

    Args:
        overwrite: Overwrite a file that was edited outside the library.

    Returns:
        False if the file was edited outside the library: it can be applied or overwritten.

    Raises:
        StorageError: The disk failed; the records are safe, and a later export writes them.
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        slug = None if record is None else record.slug
    if slug is None:
        return True
    derived = library.map_folder(slug) / DERIVED
    if not has_library(library.folder):  # not mounted: do not write files below the mount point
        raise StorageError("the folder of the library is missing", where=str(library.folder))
    try:
        derived.mkdir(parents=True, exist_ok=True)
        with FileLock(derived / LOCK, poll_interval=_POLL_S):
            return _export(library, map_id, cfg=library.cfg(slug), overwrite=overwrite)
    except OSError as error:
        raise storage_error(error, where=slug) from error


def export_late_maps(library: Library) -> bool:
    """Write the files of all maps that are older than their records.

    Returns:
        False if one of them could not be written; the reason is in the log.
    """
    with library.database.read() as session:
        late = (MapRecord.exported_revision < MapRecord.revision, MapRecord.satellite_path.is_not(None))
        ids = session.scalars(select(MapRecord.id).where(*late)).all()
    all_written = True
    for id in ids:
        try:
            export_map(library, id)
        except ExpMapError as error:
            _log.warning("the files of map %d are not current: %s", id, error)
            all_written = False
    return all_written


def changed_outside(record: MapRecord, cfg: Path) -> bool:
    """Check whether `map.cfg` is neither the version written last nor the one before."""
    return file_sha256(cfg) not in (None, record.exported_sha256, record.previous_sha256)


def file_sha256(path: Path) -> str | None:
    """Hash a small file; None if it does not exist."""
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
    old = _exported_placements(cfg) - {placement.name for placement in map_.placements} - {cfg.stem}
    write_map(cfg, map_)
    for name in old:
        placement_path(cfg, name).unlink(missing_ok=True)
    with library.database.write() as session:
        session.get_one(MapRecord, map_id).exported_revision = map_.revision
    return True


def _announce(library: Library, map_id: int, map_: Map, *, cfg: Path) -> None:
    """Record the hashes of the current and the new file, as a killed writer may leave either of them.

    The revision is recorded only after the files are written, so that the next run completes the export.
    """
    there = file_sha256(cfg)
    with library.database.write() as session:
        record = session.get_one(MapRecord, map_id)
        record.exported_sha256 = hashlib.sha256(format_cfg(map_)).hexdigest()
        record.previous_sha256 = there


def _exported_placements(cfg: Path) -> set[str]:
    """Return the placements that `map.json` names, without other checks of it; only their files are ours."""
    try:
        placements = json.loads(read_bytes(json_path(cfg)))["placements"]
        names = {str(placement["name"]) for placement in placements}
        for name in names:
            check_placement_name(name)
    except (MapError, ValueError, LookupError, TypeError):
        return set()
    return names
