"""The unit of work for changes of a map: they are committed together with the job that they require."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord

INDEX_JOB = "index"


@dataclass(slots=True)
class MapChange:
    session: Session
    record: MapRecord  # Loaded in `session`
    # Set at the end of the block if the photos on the map have changed: the job that updates the index.
    job: int | None = None


@contextmanager
def change_map(session: Session, map_id: int) -> Iterator[MapChange]:
    """Change a map in a writing session, and queue the job that the change requires.

    The index depends on which photos are on the map, not on their positions: the index job is queued only if
    the set of placed photos has changed, that is, the record's `photos_revision`. `map.cfg` and `map.json`
    are written by the worker, which finds the maps whose files are older than their records.

    Args:
        session: A writing one, which the caller commits.
    """
    record = session.get(MapRecord, map_id, with_for_update=True)
    if record is None:
        raise NotFound("the map does not exist, or was deleted", hint="reload the page")
    before = record.photos_revision
    change = MapChange(session, record)
    yield change
    if record.photos_revision > before:
        job = jobs.enqueue(session, INDEX_JOB, map_id=map_id)
        session.flush()
        change.job = job.id
