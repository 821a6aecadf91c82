"""The table of what can be done as a job.

A new kind is one line here and a module `webapp/jobs/NAME.py` with `run(context)`. The work may be killed at
any moment and is then done again from the start, so that every step of it can be repeated.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from webapp.errors import NotFound, UsageError
from webapp.jobs.progress import JobProgress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease
from webapp.store.schema import MapRecord


@dataclass(frozen=True, slots=True)
class Context:
    """What a job works with.

    Attributes
    ----------
    library : Library
    settings : Settings
    progress : JobProgress
        Work that takes long calls its `check`.
    lease : Lease
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


Function = Callable[[Context], Mapping[str, Any] | None]
"""Does a job and gives its result, plain values."""

KINDS: dict[str, str] = {
    "evaluate": "webapp.jobs.evaluate:run",
    "export": "webapp.jobs.export:run",
    "health": "webapp.jobs.health:run",
    "import": "webapp.jobs.import_map:run",
    "index": "webapp.jobs.index:run",
    "mission-delete": "webapp.missions.jobs.delete:run",
    "mission-fix": "webapp.missions.jobs.localize_photos:run",
    "mission-fuse": "webapp.missions.jobs.fuse:run",
    "mission-import": "webapp.missions.jobs.import_file:run",
    "mission-pieces": "webapp.missions.jobs.pieces:run",
    "sample": "webapp.sample.job:run",
    "satellite-pyramid": "webapp.jobs.satellite_pyramid:run",
    "satellite-tiles": "webapp.jobs.satellite_tiles:run",
}
"""Kind to "module:function"; the module is imported when the first job of its kind comes."""


def function(kind: str) -> Function:
    """Find what does a kind of job.

    Raises
    ------
    UsageError
        There is no such kind.
    """
    if kind not in KINDS:
        raise UsageError(
            f"this program knows no job {kind!r}", hint="was it queued by a newer one? Then update this one"
        )
    module, name = KINDS[kind].split(":")
    found: Function = getattr(importlib.import_module(module), name)
    return found
