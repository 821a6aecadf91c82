"""Progress of a job, handed from the thread that works to the one that writes it down."""

from __future__ import annotations

import threading

from webapp.progress import Progress


class JobProgress(Progress):
    """Adds up the steps of all stages, so that a bar fills once.

    Work that announces a stage of 300 steps and then one of 200 is at 300 of 500 in between, where `plan` has
    told of both; without it the second stage comes as a surprise.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sizes: list[int] = []
        self._stage = -1
        self._done = 0
        self._note = ""
        self._stop = threading.Event()

    def plan(self, *sizes: int) -> None:
        """Say roughly how many steps the stages will have; `size` then says it exactly for each."""
        with self._lock:
            self._sizes = list(sizes)

    def size(self, total: int) -> None:
        """Begin the next stage."""
        with self._lock:
            self._stage += 1
            self._done = 0
            self._sizes[self._stage : self._stage + 1] = [total]

    def advance(self, steps: int = 1) -> None:
        """Count steps that are finished."""
        with self._lock:
            self._done += steps

    def note(self, text: str) -> None:
        """Remember what is being done now."""
        with self._lock:
            self._note = text

    def cancelled(self) -> bool:
        """Tell whether the work has to stop, whatever the reason."""
        return self._stop.is_set()

    def stop(self) -> None:
        """Have the work stop."""
        self._stop.set()

    def state(self) -> tuple[int, int, str]:
        """Give steps done, steps in all, and what is being done."""
        with self._lock:
            before = sum(self._sizes[: max(self._stage, 0)])
            own = self._sizes[self._stage] if self._stage >= 0 else 0
            return before + min(self._done, own), sum(self._sizes), self._note
