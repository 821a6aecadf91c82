"""The unit of work for changes of a map: all of them come with the job that they make necessary, or none."""

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
    """A change of a map under way.

    Attributes
    ----------
    record : MapRecord
        Of this session.
    job : int or None
        Set at the end of the block: the job that updates the index, where other photos are on the map now.
    """

    session: Session
    record: MapRecord
    job: int | None = None


@contextmanager
def change_map(session: Session, map_id: int) -> Iterator[MapChange]:
    """Change a map in a session that writes, and queue what follows from the change.

    The index depends on which photos are on the map, not on where they are: only where the set of placed
    photos has changed, which the record's `photos_revision` says, the index job is queued. `map.cfg` and
    `map.json` are written by the worker, which finds the maps whose files are older than their records.

    Parameters
    ----------
    session : Session
        That writes; its owner commits it.

    Raises
    ------
    NotFound
        The map does not exist.
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
