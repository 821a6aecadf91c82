"""What a job works with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.jobs.progress import JobProgress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps.changing import MapChange, change_map
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease
from webapp.store.schema import MapRecord


@dataclass(frozen=True, slots=True)
class Context:
    """What a job works with.

    Attributes
    ----------
    progress : JobProgress
        Work that takes long calls its `check`.
    map_id, account_id : int or None
        Whose map it is about, and who wants it.
    arguments : mapping
        As they were queued.
    """

    library: Library
    settings: Settings
    progress: JobProgress
    lease: Lease
    map_id: int | None
    account_id: int | None
    arguments: Mapping[str, Any]

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Give a session that writes, and is kept only if the job's lease has not been lost.

        Raises
        ------
        Conflict
            It has.
        """
        with self.library.database.write() as session:
            jobs.guard(session, self.lease)
            yield session

    @contextmanager
    def changing(self, map_id: int) -> Iterator[MapChange]:
        """Change a map as `Library.changing` does, if the job's lease has not been lost.

        Raises
        ------
        Conflict
            It has.
        """
        with self.write() as session, change_map(session, map_id) as change:
            yield change

    def map(self) -> MapRecord:
        """Read the map's record.

        Raises
        ------
        NotFound
            It has been deleted in the meantime.
        """
        with self.library.database.read() as session:
            record = None if self.map_id is None else session.get(MapRecord, self.map_id)
        if record is None:
            raise NotFound("the map of this job is not there any more")
        return record
