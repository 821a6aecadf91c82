"""Finds the file of a query photo, or a preview of it; access is checked by the caller."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from webapp.errors import NotFound
from webapp.files.atomic import write_bytes
from webapp.files.part_file import discard, show_file_as
from webapp.files.photos.preview import SIDES, Kind, make_previews, preview_name
from webapp.settings import Settings
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import QueryRecord


def original(library: Library, query: QueryRecord) -> Path:
    """Return the original file of a query.

    Raises
    ------
    NotFound
        It is missing on the disk.
    """
    path = queries.folder(library, query.map_id) / query.file
    if not path.is_file():
        raise NotFound("the photo of this answer is missing", where=query.name, hint="ask again")
    return path


def preview(library: Library, query: QueryRecord, *, kind: Kind, settings: Settings) -> Path:
    """Return a preview of a query, which is created on first use.

    Raises
    ------
    NotFound, PhotoError
        The photo is missing or damaged.
    StorageError
        The file cannot be written.
    """
    path = _preview_path(library, query, kind)
    if not path.exists():
        source = original(library, query)
        with show_file_as(query.name, source):
            made = make_previews(source, limits=settings.photo)
        for other, data in made.items():
            write_bytes(_preview_path(library, query, other), data)
    return path


def delete_files(library: Library, rows: Iterable[QueryRecord]) -> None:
    """Delete the files of queries whose records are gone."""
    for query in rows:
        for kind in SIDES:
            path = _preview_path(library, query, kind)
            discard(path)
            discard(path.with_suffix(".jpg"))  # the name in version 0.7.0
        discard(queries.folder(library, query.map_id) / query.file)


def _preview_path(library: Library, query: QueryRecord, kind: Kind) -> Path:
    return queries.folder(library, query.map_id) / preview_name(Path(query.file).stem, kind)
