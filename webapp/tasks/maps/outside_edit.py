"""A `map.cfg` that somebody changed outside of the library: shown, and taken over or written anew."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from webapp.errors import Conflict, MapError, NotFound, UsageError
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import edits
from webapp.store.schema import MapRecord
from webapp.tasks.maps import export
from webapp.tasks.maps.export import changed_outside, file_sha256
from webapp.tasks.maps.new_rows import PhotoFiles, add_removed
from webapp.tasks.maps.outside_plan import TakeOverPlan, plan
from webapp.tasks.told_below import below, told_below

KIND = "outside"
"""Of the edit that takes a file over."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What was taken over.

    Attributes
    ----------
    revision : int or None
        That the edit made; None when the file said the same in other words.
    left_out : tuple of str
        Sentences about photos that could not be read.
    """

    revision: int | None
    left_out: tuple[str, ...]


def show(library: Library, map_id: int, *, settings: Settings) -> dict[str, Any] | None:
    """Compare the file with the records.

    Parameters
    ----------
    settings : Settings
        The limits of photos count.

    Returns
    -------
    dict or None
        None when nobody has changed the file. Else `sha256` of the file; `problem`, a sentence, where it
        cannot be taken over; `moved`, `turned`, `added`, `removed`, `kept`, lists of photos; `left_out`,
        sentences; `placements`, names; `georeference`, whether it changes.
    """
    with library.database.read() as session:
        record = _record(session.get(MapRecord, map_id))
        cfg = library.cfg(record.slug)
        if not changed_outside(record, cfg):
            return None
        sha256 = file_sha256(cfg)
        try:
            found = plan(session, record, cfg, files=PhotoFiles(cfg, settings.photo))
        except (MapError, UsageError) as error:
            return {"sha256": sha256, "problem": below(str(error), cfg.parent), **_told(TakeOverPlan())}
    return {"sha256": sha256, "problem": None, **_told(found)}


def take(library: Library, map_id: int, *, account_id: int, settings: Settings, sha256: str) -> Taken:
    """Take the file over into the records, as one edit that can be undone.

    Parameters
    ----------
    account_id : int
        Who does it.
    sha256 : str
        Of the file that was shown.

    Raises
    ------
    MapError, UsageError
        The file cannot be taken over.
    Conflict
        The file is another one by now, or has not been changed.
    StorageError
        The disk refused; what was taken over is safe.
    """
    with library.database.read() as session:
        record = _record(session.get(MapRecord, map_id))
        cfg = library.cfg(record.slug)
        files = PhotoFiles(cfg, settings.photo)
        _check_same(record, cfg, sha256=sha256)
        with told_below(cfg.parent):
            plan(session, record, cfg, files=files)  # reads the photos, while others may write
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        _check_same(record, cfg, sha256=sha256)
        with told_below(cfg.parent):
            found = plan(session, record, cfg, files=files)
        add_removed(session, record, found.new)
        for id, path in found.renamed.items():
            next(photo for photo in record.photos if photo.id == id).path = path
        edit = edits.apply(session, record, changes=found.changes, kind=KIND, account_id=account_id)
        record.exported_sha256 = sha256
        if found.renamed:
            record.photos_revision = record.revision
    return Taken(None if edit is None else edit.turn, tuple(found.left_out))


def discard(library: Library, map_id: int, *, sha256: str) -> None:
    """Write the file anew from the records.

    Raises
    ------
    Conflict
        The file is another one than was shown.
    StorageError
    """
    with library.database.read() as session:
        cfg = library.cfg(_record(session.get(MapRecord, map_id)).slug)
    if file_sha256(cfg) != sha256:
        raise Conflict("the file has changed since it was shown", hint="reload and compare again")
    export.export_map(library, map_id, overwrite=True)


def _check_same(record: MapRecord, cfg: Path, *, sha256: str) -> None:
    if not changed_outside(record, cfg) or file_sha256(cfg) != sha256:
        raise Conflict("the file has changed since it was shown", hint="reload and compare again")


def _record(found: MapRecord | None) -> MapRecord:
    if found is None:
        raise NotFound("there is no such map")
    return found


def _told(found: TakeOverPlan) -> dict[str, Any]:
    return {
        "moved": found.moved,
        "turned": found.turned,
        "added": found.added,
        "removed": found.removed,
        "kept": found.kept,
        "left_out": found.left_out,
        "placements": found.placements,
        "georeference": found.georeference,
    }
