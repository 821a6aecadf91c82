"""Puts right what the linter found, as an edit that can be undone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.maps.folder import photo_path
from webapp.files.satellite.image_probe import image_size
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import outside_edit
from webapp.tasks.maps.adopt_map import photo_row
from webapp.tasks.maps.findings import FIX_NAMES, orphans
from webapp.tasks.maps.new_rows import add_removed
from webapp.tasks.told_below import told_below

KIND = "fix"
"""Of the edit."""

Changes = dict[str, Mapping[str, Any] | None]


def fix_findings(
    library: Library, map_id: int, *, fix: str, ids: Sequence[int], account_id: int, settings: Settings
) -> int | None:
    """Apply a fix to the photos that a finding is about.

    Parameters
    ----------
    fix : str
        One of `findings.FIX_NAMES`.
    ids : sequence of int
        Photos; not needed for fixes of the map as a whole.
    account_id : int
        Who does it.

    Returns
    -------
    int or None
        Revision that the edit made; None when the records stayed as they were.

    Raises
    ------
    UsageError
        There is no such fix, or it does not help here.
    NotFound
        A photo that the map has not.
    Conflict
        There is nothing to put right any more.
    MapError, PhotoError, StorageError
    """
    if fix not in FIX_NAMES:
        raise UsageError(f"there is no fix {fix!r}", where="code", hint=f"use one of {', '.join(FIX_NAMES)}")
    if fix in ("outside-take", "outside-discard"):
        take = fix == "outside-take"
        return _outside(library, map_id, take=take, account_id=account_id, settings=settings)
    strangers = _strangers(library, map_id, settings=settings) if fix == "adopt" else []
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        cfg = library.cfg(record.slug)
        with told_below(cfg.parent):
            if fix == "adopt":
                changes = _adopt(session, record, strangers)
            elif fix == "image-size":
                changes = _true_size(session, record, cfg)
            else:
                changes = {
                    f"photo/{id}": _of_photo(session, record, id, fix=fix) for id in dict.fromkeys(ids)
                }
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
        if edit is None:
            raise Conflict("there is nothing left to fix", hint="check the map again")
    return edit.turn


def _outside(library: Library, map_id: int, *, take: bool, account_id: int, settings: Settings) -> int | None:
    shown = outside_edit.show(library, map_id, settings=settings)
    if shown is None:
        raise Conflict("the map file has not been changed from outside", hint="check the map again")
    sha256 = shown["sha256"]
    if take:
        return outside_edit.take(
            library, map_id, account_id=account_id, settings=settings, sha256=sha256
        ).revision
    outside_edit.discard(library, map_id, sha256=sha256)
    return None


def _of_photo(session: Session, record: MapRecord, id: int, *, fix: str) -> Mapping[str, Any]:
    photo = session.get(Photo, (record.id, id))
    if photo is None or photo.removed:
        raise NotFound(f"the map has no photo {id}", hint="check the map again")
    match fix:
        case "to-tray":
            return {"x_px": None, "y_px": None}
        case "remove":
            return {"removed": True}
        case _:
            return _swapped(record, photo)


def _swapped(record: MapRecord, photo: Photo) -> Mapping[str, Any]:
    x, y = photo.y_px, photo.x_px
    if x is None or y is None or x > (record.satellite_width or 0) or y > (record.satellite_height or 0):
        raise UsageError(f"{photo.name} cannot be swapped: it would lie outside the image", where="ids")
    return {"x_px": x, "y_px": y}


def _true_size(session: Session, record: MapRecord, cfg: Path) -> Changes:
    """Take the image's own size; photos that are outside then go back to the tray."""
    if record.satellite_path is None:
        raise UsageError("the map has no satellite image", hint="upload one")
    width, height = image_size(photo_path(cfg, record.satellite_path))
    changes: Changes = {"map": {"satellite_width": width, "satellite_height": height}}
    for photo in maps.photos(session, record):
        if photo.x_px is not None and photo.y_px is not None and (photo.x_px > width or photo.y_px > height):
            changes[f"photo/{photo.id}"] = {"x_px": None, "y_px": None}
    return changes


def _strangers(library: Library, map_id: int, *, settings: Settings) -> list[Photo]:
    """Read the photos of the folder that no record knows; unreadable ones stay where they are."""
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        cfg = library.cfg(record.slug)
        with told_below(cfg.parent):
            names = [name for name in orphans(session, record, cfg) if not name_problem(name)]
    read = (photo_row(cfg, Experience(0, name, MapPixel(0.0, 0.0)), limits=settings.photo) for name in names)
    return [row for row, problem in read if problem is None]


def _adopt(session: Session, record: MapRecord, strangers: Sequence[Photo]) -> Changes:
    """Bring photos into the tray, each once, without those that have come into the map meanwhile."""
    rows = maps.photos(session, record)
    known = {row.path for row in rows} | {row.sha256 for row in rows}
    new: list[Photo] = []
    for row in strangers:
        if row.path not in known and row.sha256 not in known:
            known.add(row.sha256)
            row.id = record.next_id + len(new)
            row.x_px = row.y_px = None
            row.removed = True
            new.append(row)
    add_removed(session, record, new)
    return {f"photo/{row.id}": {"removed": False} for row in new}
