"""Work spread over threads; for calls into libraries that let go of the interpreter while they work."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from threading import Lock
from typing import Generic, TypeVar

In = TypeVar("In")
Out = TypeVar("Out")


def cores() -> int:
    """Count the processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(function: Callable[[In], Out], items: Iterable[In]) -> list[Out]:
    """Call a function with each item, as many at once as there are cores.

    Parameters
    ----------
    function : callable
        Safe to be called from several threads at once.
    items : iterable

    Returns
    -------
    list
        The results in the order of the items. The first error in that order is raised.
    """
    listed = list(items)
    workers = min(cores(), len(listed))
    if workers < 2:
        return [function(item) for item in listed]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, listed))


def one_at_a_time(
    block: Callable[[], AbstractContextManager[None]],
) -> Callable[[], AbstractContextManager[None]]:
    """Let one thread at a time into a block that changes what all threads share; the others wait."""
    lock = Lock()

    @contextmanager
    @wraps(block)
    def alone() -> Iterator[None]:
        with lock, block():
            yield

    return alone


class Pool(Generic[Out]):
    """Things that may be used by one thread at a time: lent, and kept for whoever comes next.

    There are as many as were ever used at the same time, not as many as there are threads.

    Parameters
    ----------
    make : callable
        Makes one.
    """

    def __init__(self, make: Callable[[], Out]) -> None:
        self._make = make
        self._idle: list[Out] = []

    @contextmanager
    def lent(self) -> Iterator[Out]:
        """Lend the one that came back last, or a new one; after an error nobody gets it again."""
        try:
            thing = self._idle.pop()
        except IndexError:
            thing = self._make()
        yield thing
        self._idle.append(thing)

    @contextmanager
    def renewed(self) -> Iterator[Out]:
        """Lend a new one, which is kept as the others are."""
        thing = self._make()
        yield thing
        self._idle.append(thing)
