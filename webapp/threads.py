"""Thread pools, for libraries that release the GIL, and limits of concurrency."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import Semaphore
from typing import Any, TypeVar

from webapp.errors import Busy

In = TypeVar("In")
Out = TypeVar("Out")


class ContextThreads(ThreadPoolExecutor):
    """Threads that inherit the caller's context (request or job), for logs and traces."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call that runs in a copy of the current context."""
        return super().submit(copy_context().run, function, *args, **kwargs)


def cores() -> int:
    """Count the processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(function: Callable[[In], Out], items: Iterable[In]) -> list[Out]:
    """Call a function with each item, in as many threads as there are cores.

    Returns:
        The results in the order of the items. The first error in that order is raised.
    """
    listed = list(items)
    workers = min(cores(), len(listed))
    if workers < 2:
        return [function(item) for item in listed]
    with ContextThreads(workers) as pool:
        return list(pool.map(function, listed))


@contextmanager
def permit(semaphore: Semaphore, *, wait_s: float = 20.0) -> Iterator[None]:
    """Hold a permit of a semaphore within the block."""
    if not semaphore.acquire(timeout=wait_s):
        raise Busy("the server is busy", wait_s=10, hint="try again in a moment")
    try:
        yield
    finally:
        semaphore.release()
