"""Runs parts on this machine: in the calling thread, in a pool of threads, or in processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import takewhile
from multiprocessing import connection
from typing import Any, Protocol

import cv2

from webapp.errors import ProcessLost
from webapp.logs import Carried, carried, take_over
from webapp.settings import keep_freed_memory
from webapp.threads import ContextThreads


class Inline:
    """Runs each part when its result is requested."""

    at_once = 1

    def __init__(self, function: Part, shared: Any) -> None:
        self._do = partial(function, shared)

    def submit(self, item: Any, *, of: int) -> Any:
        """Return the item itself as the handle of the part."""
        return item

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Run the first part and yield its result."""
        yield self._do(waiting[0])

    def close(self, waiting: Sequence[Any]) -> None:
        """Do nothing: no part is running."""


class LocalPool:
    """Runs parts in an executor of the standard library."""

    def __init__(self, executor: Executor, do: partial[Any], *, at_once: int) -> None:
        self._executor = executor
        self._do = do
        self.at_once = at_once

    def submit(self, item: Any, *, of: int) -> Future[Any]:
        with _interrupts_held_back():
            return self._executor.submit(self._do, item)

    def finished(self, waiting: Sequence[Future[Any]]) -> Iterator[Any]:
        """Yield the results of the first parts that are finished, in order. Raises ProcessLost."""
        wait([waiting[0]], timeout=LOOK_EVERY_S)
        try:
            for future in takewhile(Future.done, list(waiting)):
                yield future.result()
        except BrokenProcessPool as error:
            raise ProcessLost(
                "a worker process was killed",
                hint="too little memory? Use fewer --jobs. "
                "In a script, call it below if __name__ == '__main__':",
            ) from error

    def close(self, waiting: Sequence[Future[Any]]) -> None:
        """Cancel pending parts, wait for running ones and shut down."""
        self._executor.shutdown(wait=True, cancel_futures=True)


def threads(function: Part, shared: Any, *, workers: int) -> LocalPool:
    """Make a pool of threads, for libraries that release the GIL."""
    return LocalPool(ContextThreads(workers), partial(function, shared), at_once=4 * workers)


def processes(function: Part, shared: Any, *, workers: int) -> LocalPool:
    # Spawned, not forked: OpenCV and Faiss have threads that do not survive a fork.
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(
        workers, mp_context=context, initializer=start_worker, initargs=(carried(),)
    )
    return LocalPool(executor, partial(function, shared), at_once=4 * workers)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Block SIGINT while processes start, so that Ctrl-C does not kill them before they ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_worker(log: Carried) -> None:
    """Prepare a worker process: one native thread, and exit when the parent ends, however that happens."""
    take_over(log)
    cv2.setNumThreads(1)
    keep_freed_memory()
    # Ctrl-C is sent to all processes of a terminal, but only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


LOOK_EVERY_S = 0.5
"""Maximum duration of a wait, so that the work can be cancelled."""

Part = Callable[[Any, Any], Any]
"""A module-level, thread-safe function of the shared value and an item."""


class Pool(Protocol):
    """Runs parts of some work."""

    @property
    def at_once(self) -> int:
        """Maximum number of submitted parts, which bounds the memory."""

    def submit(self, item: Any, *, of: int) -> Any:
        """Submit a part; return its handle.

        Args:
            of: Number of parts that are submitted or about to be: with few, each gets more cores.
        """

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Yield the results of the first parts that are finished, after a short wait for the first one."""

    def close(self, waiting: Sequence[Any]) -> None:
        """Cancel pending parts and shut down."""
