"""Writes `map.cfg` and `map.json` of library maps from the database.

The database is the truth, and an edit is acknowledged once it is in there (`Library.changing`). The files
follow: the worker calls `export_late_maps` twice a second, so that many quick edits cost one export; after a
kill it continues where it was. Whoever reads the files, or gives them out, calls `export_map` before.
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
"""An export takes a few hundredths of a second."""


def export_map(library: Library, map_id: int, *, overwrite: bool = False) -> bool:
    """Write the files of a map if they are older than its records.

    Several at once take turns, and the next one finds the newest revision written already. A `map.cfg` that
    was changed from outside is left as it is.

    Parameters
    ----------
    overwrite : bool
        Write over a file that was changed from outside.

    Returns
    -------
    bool
        False when the file was changed from outside: it can be taken over or overwritten.

    Raises
    ------
    StorageError
        The disk refused; the records are safe, and a later export writes them.
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        slug = None if record is None else record.slug
    if slug is None:
        return True
    derived = library.map_folder(slug) / DERIVED
    if not has_library(library.folder):  # not mounted: what is written here would be in the way later
        raise StorageError("the folder of the library is not there", where=str(library.folder))
    try:
        derived.mkdir(parents=True, exist_ok=True)
        with FileLock(derived / LOCK, poll_interval=_POLL_S):
            return _export(library, map_id, cfg=library.cfg(slug), overwrite=overwrite)
    except OSError as error:
        raise storage_error(error, where=slug) from error


def export_late_maps(library: Library) -> bool:
    """Write the files of all maps that are older than their records.

    Returns
    -------
    bool
        False where the disk refused for one of them; the log says why.
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
    """Check whether `map.cfg` is neither what was written last nor what was there before."""
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
    old = _exported_placements(cfg) - {placement.name for placement in map_.placements} - {cfg.stem}
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
    there = file_sha256(cfg)
    with library.database.write() as session:
        record = session.get_one(MapRecord, map_id)
        record.exported_sha256 = hashlib.sha256(format_cfg(map_)).hexdigest()
        record.previous_sha256 = there


def _exported_placements(cfg: Path) -> set[str]:
    """Names of the placements in `map.json`, without a check of all else in it; only their files are ours."""
    try:
        placements = json.loads(read_bytes(json_path(cfg)))["placements"]
        names = {str(placement["name"]) for placement in placements}
        for name in names:
            check_placement_name(name)
    except (MapError, ValueError, LookupError, TypeError):
        return set()
    return names
