"""Files of satellite images in a map's folder: named by content, never changed; unused ones are deleted."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import UsageError
from webapp.files.atomic import write_text
from webapp.store.library import Library
from webapp.store.maps.edits import FLOORS_KIND, OUTSIDE_KIND
from webapp.store.schema import Edit, MapRecord
from webapp.tasks.satellite import display

_OURS = re.compile(r"satellite-[0-9a-f]{8}\.(png|jpg)")
"""Names given by `webapp.files.satellite.raster`."""


def keep_source(folder: Path, name: str, *, source: Mapping[str, Any]) -> None:
    """Store the source of an image next to it, above all its attribution."""
    write_text(
        (folder / name).with_suffix(".json"), json.dumps(dict(source), indent=1, ensure_ascii=False) + "\n"
    )


def source_of(folder: Path, name: str) -> dict[str, Any]:
    """Read the source of an image; empty if unknown."""
    sidecar = (folder / name).with_suffix(".json")
    if not name.startswith("satellite-") or not sidecar.is_file():
        return {}
    try:
        content = json.loads(sidecar.read_text("utf-8"))
    except (OSError, ValueError):  # only the attribution is lost: the image can still be shown
        return {}
    return content if isinstance(content, dict) else {}


def images_in_use(record: MapRecord) -> set[str]:
    names = {record.satellite_path, *(_image(floor) for floor in record.floors or ())}
    return {name for name in names if name}


def images_of(session: Session, record: MapRecord) -> set[str]:
    """Return the names of the present and former images of the map and its floors: undo can restore these."""
    kinds = ("satellite", FLOORS_KIND, OUTSIDE_KIND)
    found = select(Edit).where(Edit.map_id == record.id, Edit.kind.in_(kinds))
    names: set[str | None] = {*images_in_use(record)}
    for edit in session.scalars(found):
        for change in edit.changes:
            for side in (change["before"], change["after"]):
                names.add((side or {}).get("satellite_path"))
                if change["target"].startswith("floor/"):
                    names.add(_image(side or {}))
    return {name for name in names if name}


def _image(floor: Mapping[str, Any]) -> str | None:
    image = floor.get("image")
    return None if image is None else str(image["path"])


@contextmanager
def removed_if_refused(library: Library, map_id: int, *, name: str) -> Iterator[None]:
    try:
        yield
    except UsageError:
        with library.database.write() as session:
            record = session.get_one(MapRecord, map_id)
            if name not in images_of(session, record):
                display.forget(library.map_folder(record.slug), name)
        raise


def sweep(library: Library, map_id: int, *, keep: timedelta) -> int:
    """Delete images that a killed process has left, once they are old enough; return their number."""
    before = time.time() - keep.total_seconds()
    with library.database.read() as session:
        if not _left_behind(session, library, map_id, before=before):
            return 0
    with library.database.write() as session:  # look again: an image may be in use by now
        gone = _left_behind(session, library, map_id, before=before)
        for path in gone:
            display.forget(path.parent, path.name)
    return len(gone)


def _left_behind(session: Session, library: Library, map_id: int, *, before: float) -> list[Path]:
    """List the images in a map's folder that are old enough and that neither record nor history has."""
    record = session.get_one(MapRecord, map_id)
    known = images_of(session, record)
    return [
        path
        for path in library.map_folder(record.slug).glob("satellite-*")
        if _OURS.fullmatch(path.name) and path.name not in known and path.stat().st_mtime < before
    ]
