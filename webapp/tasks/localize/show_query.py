"""Finds the file of a query photo; access is checked by the caller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.files.part_file import discard, sha256_of
from webapp.files.photos.photo import blur_key
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import QueryRecord
from webapp.tasks.maps.pictures import PhotoFile, boxes_for


def original(library: Library, query: QueryRecord) -> Path:
    """Return the original file of a query.

    Raises:
        NotFound: It is missing on the disk.
    """
    path = queries.folder(library, query.map_id) / query.file
    if not path.is_file():
        raise NotFound("the photo of this answer is missing", where=query.name, hint="ask again")
    return path


def file_of(library: Library, query: QueryRecord) -> PhotoFile:
    """Return the photo of an answer as its pictures are made of it.

    Raises:
        NotFound: The answer is of an older version, which stored no hash, and its photo is missing.
    """
    return PhotoFile(
        query.name,
        query.sha256 or sha256_of(original(library, query)),
        partial(original, library, query),
        queries.folder(library, query.map_id),
        Path(query.file).stem,
        adopted=None if query.adopted_id is None else (query.map_id, query.adopted_id),
    )


def looks(session: Session, library: Library, *, rows: Sequence[QueryRecord]) -> list[str | None]:
    """Return a key of what is blurred in the photo of each answer; None if nothing is, or it is missing."""
    found: dict[int, PhotoFile] = {}
    for row in rows:
        with suppress(NotFound):
            found[row.id] = file_of(library, row)
    boxes = boxes_for(session, [*found.values()], audience="members")
    keys = {id: blur_key(one) for id, one in zip(found, boxes, strict=True)}
    return [keys.get(row.id) for row in rows]


def delete_files(library: Library, rows: Iterable[QueryRecord]) -> None:
    """Delete the files of queries whose records are gone."""
    for query in rows:
        folder = queries.folder(library, query.map_id)
        for path in folder.glob(f"{Path(query.file).stem}-*"):  # its previews
            discard(path)
        discard(folder / query.file)
