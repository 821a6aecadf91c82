"""Files of satellite images that a map neither has nor had: refused, or of an interrupted request."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import UsageError
from webapp.store.library import Library
from webapp.store.schema import Edit, MapRecord
from webapp.tasks.satellite import display

_OURS = re.compile(r"satellite-[0-9a-f]{8}\.(png|jpg)")
"""A name that `satellite_files` gives."""


def images_of(session: Session, record: MapRecord) -> set[str]:
    """Name the satellite images that the map has, and has had: undo brings them back."""
    found = select(Edit).where(Edit.map_id == record.id, Edit.kind == "satellite")
    names = {record.satellite_path}
    for edit in session.scalars(found):
        for change in edit.changes:
            for side in (change["before"], change["after"]):
                names.add((side or {}).get("satellite_path"))
    return {name for name in names if name}


@contextmanager
def taken_back_if_refused(library: Library, map_id: int, *, name: str) -> Iterator[None]:
    """Delete the file of a new image where the map refuses it.

    Parameters
    ----------
    name : str
        Of the image in the map's folder.

    Raises
    ------
    UsageError
        The refusal of the block, passed on.
    """
    try:
        yield
    except UsageError:
        with library.database.write() as session:
            record = session.get_one(MapRecord, map_id)
            if name not in images_of(session, record):
                display.forget(library.map_folder(record.slug), name)
        raise


def sweep(library: Library, map_id: int, *, keep: timedelta) -> int:
    """Delete images that a killed process has left, once they are old enough to be nobody's any more.

    Returns
    -------
    int
        Images deleted.
    """
    with library.database.write() as session:
        record = session.get_one(MapRecord, map_id)
        folder, known = library.map_folder(record.slug), images_of(session, record)
        before = time.time() - keep.total_seconds()
        gone = [
            path.name
            for path in folder.glob("satellite-*")
            if _OURS.fullmatch(path.name) and path.name not in known and path.stat().st_mtime < before
        ]
        for name in gone:
            display.forget(folder, name)
    return len(gone)
