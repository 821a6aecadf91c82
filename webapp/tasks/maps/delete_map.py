"""Permanently deletes a map in the bin, and files that a job wrote for a deleted map."""

from __future__ import annotations

import secrets
import shutil
from pathlib import Path

from sqlalchemy import select

from webapp.errors import Conflict, NotFound, StorageError
from webapp.files.listing import DERIVED
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.maps.blurred import keep_boxes
from webapp.store.schema import MapRecord

_DELETED = "deleted"
"""Folder for files being deleted, next to the database."""


def delete_map(library: Library, map_id: int) -> None:
    """Delete a map: its records, then its files. Of blurred photos, hashes and boxes are kept.

    The folders are first moved out of the library; after a kill in between, the map is still in the bin and
    can be deleted again.

    Raises:
        NotFound: The map does not exist.
        Conflict: It is not in the bin.
        StorageError: A folder cannot be moved.
    """
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("map not found")
        if record.binned_at is None:
            raise Conflict(
                "only maps in the bin can be deleted", where=record.slug, hint="put it there first"
            )
        for folder in (queries.folder(library, map_id), library.map_folder(record.slug)):
            if folder.exists():
                _take_out(library, folder, slug=record.slug)
        keep_boxes(session, record)
        session.delete(record)
    _empty(library)


def delete_orphans(library: Library) -> None:
    """Delete folders to which a running job has written after their map was deleted.

    These contain derived files only; a folder with any other file is kept, as it may be a user's.
    """
    computed = [folder for folder in library.folder.glob(f"*/{DERIVED}") if _is_alone(folder)]
    if not computed:
        return
    with library.database.write() as session:  # prevents new maps meanwhile
        known = {*session.scalars(select(MapRecord.slug))}
        for folder in computed:
            # Checked again: another process may have deleted it, or a user may have added files.
            if folder.parent.name not in known and _is_alone(folder):
                _take_out(library, folder.parent, slug=folder.parent.name)
    _empty(library)


def _is_alone(folder: Path) -> bool:
    try:
        return [other.name for other in folder.parent.iterdir()] == [folder.name]
    except FileNotFoundError:  # another process has deleted it
        return False


def _take_out(library: Library, folder: Path, *, slug: str) -> None:
    """Move a folder out of the library, to the folder of deleted files."""
    deleted = library.inner / _DELETED
    deleted.mkdir(parents=True, exist_ok=True)
    try:
        folder.rename(deleted / f"{slug}-{secrets.token_hex(4)}")
    except OSError as error:
        raise StorageError(f"the map's folder cannot be deleted: {error.strerror}", where=slug) from error


def _empty(library: Library) -> None:
    for old in (library.inner / _DELETED).glob("*"):
        shutil.rmtree(old, ignore_errors=True)
