"""Deletes a map in the bin for good."""

from __future__ import annotations

import secrets
import shutil

from webapp.errors import Conflict, NotFound, StorageError
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import MapRecord


def delete_map(library: Library, map_id: int) -> None:
    """Delete a map: its records, then its files.

    The folder leaves the library first, under a name that nobody finds; killed in between, the map is still
    in the bin and can be deleted again.

    Raises
    ------
    NotFound
        The map does not exist.
    Conflict
        It is not in the bin.
    StorageError
        The disk refused.
    """
    deleted = library.inner / "deleted"
    deleted.mkdir(parents=True, exist_ok=True)
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("map not found")
        if record.binned_at is None:
            raise Conflict(
                "only maps in the bin can be deleted", where=record.slug, hint="put it there first"
            )
        for folder in (queries.folder(library, map_id), library.map_folder(record.slug)):
            if not folder.exists():
                continue
            try:
                folder.rename(deleted / f"{record.slug}-{secrets.token_hex(4)}")
            except OSError as error:
                raise StorageError(
                    f"the map's folder cannot be deleted: {error.strerror}", where=record.slug
                ) from error
        session.delete(record)
    for old in deleted.iterdir():
        shutil.rmtree(old, ignore_errors=True)
