"""Queues what brings the search for similar photos up to date after a move, or a backup that was restored."""

from __future__ import annotations

from webapp.store.library import Library
from webapp.store.operate import jobs

JOB = "describe-library"


def queue_refresh(library: Library) -> None:
    """Queue the job where the database can search for similar photos and lacks some.

    Raises
    ------
    StorageError
    """
    database = library.database
    if database.photo_search is None:
        return
    with database.translated_errors():
        behind = database.photo_search.is_behind()
    if behind:
        with database.write() as session:
            jobs.enqueue(session, JOB)
