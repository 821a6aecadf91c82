"""Calls a function with each item, and gives the results in the order of the items."""

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
from webapp.tasks.computing.pool import Pool
from webapp.threads import cores

Shared = TypeVar("Shared")
In = TypeVar("In")
Out = TypeVar("Out")


@dataclass(frozen=True, slots=True)
class Workplace:
    """Where the parts of some work are done.

    Attributes
    ----------
    settings : Settings
        With an address of Dask the parts are done there.
    folder : Path
        What they read or write is in it, or in another one that is reached in the same way: workers have to
        see the same folder.
    here : {"inline", "threads", "processes"}
        How they are done on this machine.
    workers : int or None
        Threads or processes here; None for as many as there are cores.
    """

    settings: Settings
    folder: Path
    here: Literal["inline", "threads", "processes"] = "inline"
    workers: int | None = None

    def on_this_machine(self) -> Workplace:
        """Give the place for so little that sending it would take longer: this process."""
        return Workplace(replace(self.settings, dask=None), self.folder)


def in_order(
    function: Callable[[Shared, In], Out],
    items: Iterable[In],
    *,
    shared: Shared,
    at: Workplace,
    progress: Progress,
) -> Iterator[Out]:
    """Call a function with each item; what is finished is given at once, in the order of the items.

    Parameters
    ----------
    function : callable
        Of a module, for processes and Dask; takes `shared` and an item. It can be repeated: where a worker of
        Dask is lost, what it was doing is done by another one.
    shared : object
        What all calls need; like items and results, it can be pickled.
    progress : Progress
        Is asked whether to stop after each result, and at least every half second. What has begun by then is
        finished and dropped.

    Raises
    ------
    Cancelled
    ProcessLost
        A worker process was killed; on Dask, several of them by the same part.
    ClusterUnavailable
        The scheduler of Dask cannot be reached, or is lost.
    UsageError
        Workers of Dask have other versions, or do not see the folder.
    MissingPart
        The extra `cluster` is not installed.
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


def _pool(function: Callable[[Any, Any], Any], shared: Any, *, at: Workplace, progress: Progress) -> Pool:
    if at.settings.dask is not None:
        from webapp.tasks.computing.cluster import DaskPool

        return DaskPool(function, shared, settings=at.settings, folder=at.folder, progress=progress)
    workers = at.workers or cores()
    if at.here == "inline" or workers == 1:
        return local.Inline(function, shared)
    make = local.threads if at.here == "threads" else local.processes
    return make(function, shared, workers=workers)
