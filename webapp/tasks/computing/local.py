"""Does the parts of some work on this machine: here and now, in threads, or in processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import takewhile
from multiprocessing import connection
from typing import Any

import cv2

from webapp.errors import ProcessLost
from webapp.logs import Carried, carried, take_over
from webapp.settings import keep_freed_memory
from webapp.tasks.computing.pool import LOOK_EVERY_S, Part
from webapp.threads import ContextThreads


class Inline:
    """Does one part after the other when its result is asked for."""

    at_once = 1

    def __init__(self, function: Part, shared: Any) -> None:
        self._do = partial(function, shared)

    def submit(self, item: Any, *, of: int) -> Any:
        """Take a part; the item stands for it."""
        return item

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Do the first part."""
        yield self._do(waiting[0])

    def close(self, waiting: Sequence[Any]) -> None:
        """Nothing has begun."""


class LocalPool:
    """Does parts in an executor of the standard library."""

    def __init__(self, executor: Executor, do: partial[Any], *, at_once: int) -> None:
        self._executor = executor
        self._do = do
        self.at_once = at_once

    def submit(self, item: Any, *, of: int) -> Future[Any]:
        """Begin a part."""
        with _interrupts_held_back():
            return self._executor.submit(self._do, item)

    def finished(self, waiting: Sequence[Future[Any]]) -> Iterator[Any]:
        """Give the results of the first parts that are finished.

        Raises
        ------
        ProcessLost
        """
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
        """Wait for the parts that have begun, and end."""
        self._executor.shutdown(wait=True, cancel_futures=True)


def threads(function: Part, shared: Any, *, workers: int) -> LocalPool:
    """Make a pool of threads, for libraries that let go of the interpreter."""
    return LocalPool(ContextThreads(workers), partial(function, shared), at_once=4 * workers)


def processes(function: Part, shared: Any, *, workers: int) -> LocalPool:
    """Make a pool of processes."""
    # Spawned, not forked: OpenCV and Faiss have threads that a fork would leave half alive.
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(
        workers, mp_context=context, initializer=start_worker, initargs=(carried(),)
    )
    return LocalPool(executor, partial(function, shared), at_once=4 * workers)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Start processes that do not see Ctrl-C, which would kill them before they can ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_worker(log: Carried) -> None:
    """Prepare a worker process: one native thread, and an end with its parent, however that ends."""
    take_over(log)
    cv2.setNumThreads(1)
    keep_freed_memory()
    # Ctrl-C reaches all processes of a terminal, but it is the parent that decides how to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)
