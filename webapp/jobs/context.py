"""The context of a job: its inputs, its lease and its progress."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps.changing import MapChange, change_map
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease
from webapp.store.schema import MapRecord


@dataclass(frozen=True, slots=True)
class Context:
    """The inputs of a job, its lease and its progress."""

    library: Library
    settings: Settings
    progress: JobProgress  # Long-running work has to call its `check` regularly
    lease: Lease
    # `map_id`, `account_id`: The map concerned, and the account that requested the job.
    map_id: int | None
    account_id: int | None
    arguments: Mapping[str, Any]  # As they were queued

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Open a write transaction, provided that the job still holds its lease."""
        with self.library.database.write() as session:
            jobs.guard(session, self.lease)
            yield session

    @contextmanager
    def changing(self, map_id: int) -> Iterator[MapChange]:
        """Change a map as `Library.changing` does, provided that the job still holds its lease."""
        with self.write() as session, change_map(session, map_id) as change:
            yield change

    def map(self) -> MapRecord:
        with self.library.database.read() as session:
            record = None if self.map_id is None else session.get(MapRecord, self.map_id)
        if record is None:
            raise NotFound("the map of this job no longer exists")
        return record


class JobProgress(Progress):
    """Adds up the steps of all stages, so that a progress bar fills only once.

    Between a stage of 300 steps and one of 200, the progress is 300 of 500 if `plan` has announced both;
    otherwise it is 300 of 300, and the total grows when the second stage begins.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sizes: list[int] = []
        self._stage = -1
        self._done = 0
        self._note = ""
        self._stop = threading.Event()
        self._gives_way = threading.Event()

    def plan(self, *sizes: int) -> None:
        """Announce the approximate steps of all stages; `size` replaces the value of each when it begins."""
        with self._lock:
            self._sizes = list(sizes)

    def size(self, total: int) -> None:
        """Begin the next stage, of `total` steps."""
        with self._lock:
            self._stage += 1
            self._done = 0
            self._sizes[self._stage : self._stage + 1] = [total]

    def advance(self, steps: int = 1) -> None:
        with self._lock:
            self._done += steps

    def skip(self, steps: int = 1) -> None:
        """Leave out steps of an earlier run, so that the pace is that of the others."""
        with self._lock:
            if self._stage >= 0:
                self._sizes[self._stage] = max(self._sizes[self._stage] - steps, 0)

    def note(self, text: str) -> None:
        """Set the description of the current step."""
        with self._lock:
            self._note = text

    def cancelled(self) -> bool:
        """Return whether the work has to stop, for whatever reason."""
        return self._stop.is_set()

    def stop(self) -> None:
        self._stop.set()

    def give_way(self) -> None:
        """Request that the work stops to be continued later."""
        self._gives_way.set()
        self._stop.set()

    def gives_way(self) -> bool:
        """Return whether the work was stopped to be continued later."""
        return self._gives_way.is_set()

    def state(self) -> tuple[int, int, str]:
        """Return the finished steps, the total, and the description of the current step."""
        with self._lock:
            before = sum(self._sizes[: max(self._stage, 0)])
            own = self._sizes[self._stage] if self._stage >= 0 else 0
            return before + min(self._done, own), sum(self._sizes), self._note
