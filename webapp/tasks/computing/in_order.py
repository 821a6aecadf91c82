"""Calls a function with each item in parallel, and yields the results in the order of the items."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, TypeVar

from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.computing import local
from webapp.tasks.computing.local import Pool
from webapp.threads import cores

Shared = TypeVar("Shared")
In = TypeVar("In")
Out = TypeVar("Out")


@dataclass(frozen=True, slots=True)
class ExecutionTarget:
    """Where the parts are computed."""

    settings: Settings  # With a Dask address, the parts are computed there
    # Folder of the files that the parts read or write (or one on the same file system): Dask workers must be
    # able to access it.
    folder: Path
    here: Literal["inline", "threads", "processes"] = "inline"  # How they are computed on this machine
    workers: int | None = None  # Threads or processes on this machine; None for the number of cores

    def on_this_machine(self) -> ExecutionTarget:
        """Return this process as the place, for work too small to be distributed."""
        return ExecutionTarget(replace(self.settings, dask=None), self.folder)


def in_order(
    function: Callable[[Shared, In], Out],
    items: Iterable[In],
    *,
    shared: Shared,
    at: ExecutionTarget,
    progress: Progress,
) -> Iterator[Out]:
    """Call a function with each item; yield each result as soon as possible, in the order of the items.

    Args:
        function: Takes `shared` and an item. For processes and Dask it must be at module level, and
            idempotent: if a Dask worker is lost, its parts are repeated on another one.
        shared: Value passed to all calls; must be picklable, like items and results.
        progress: Checked for cancellation after each result, and at least every half second. Parts that are
            running by then are completed and their results dropped.

    Raises:
        ProcessLost: A worker process was killed; on Dask, several of them by the same part.
        ClusterUnavailable: The Dask scheduler cannot be reached, or the connection to it is lost.
        UsageError: Dask workers have other versions, or cannot access the folder.
        MissingPart: The extra `cluster` is not installed.
    """
    todo = deque(islice(items := iter(items), 1))
    if not todo:
        return
    pool = _pool(function, shared, at=at, progress=progress)
    waiting: deque[Any] = deque()
    try:
        while True:
            todo.extend(islice(items, max(pool.at_once - len(waiting) - len(todo), 0)))
            parts = len(waiting) + len(todo)
            while todo:
                waiting.append(pool.submit(todo.popleft(), of=parts))
            if not waiting:
                return
            progress.check()
            for result in pool.finished(waiting):
                waiting.popleft()
                yield result
                progress.check()
    finally:
        pool.close(waiting)


def _pool(
    function: Callable[[Any, Any], Any], shared: Any, *, at: ExecutionTarget, progress: Progress
) -> Pool:
    if at.settings.dask is not None:
        from webapp.tasks.computing.cluster import DaskPool

        return DaskPool(function, shared, settings=at.settings, folder=at.folder, progress=progress)
    workers = at.workers or cores()
    if at.here == "inline" or workers == 1:
        return local.Inline(function, shared)
    make = local.threads if at.here == "threads" else local.processes
    return make(function, shared, workers=workers)
