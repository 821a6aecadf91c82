"""Queues the update of the vector search after a library was moved, or restored from a backup."""

from __future__ import annotations

from webapp.store.library import Library
from webapp.store.operate import jobs

JOB = "describe-library"


def queue_refresh(library: Library) -> None:
    """Queue the job if the database has a vector search that is out of date. Raises StorageError."""
    database = library.database
    if database.photo_search is None:
        return
    with database.translated_errors():
        behind = database.photo_search.is_behind()
    if behind:
        with database.write() as session:
            jobs.enqueue(session, JOB)
