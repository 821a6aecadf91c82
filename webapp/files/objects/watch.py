"""Lets somebody count what the object storage and its cache are asked for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

Operation = Literal["get", "put", "delete", "list", "probe"]


class StorageWatcher(Protocol):
    """Is told of each request; by any thread."""

    def asked(self, operation: Operation, seconds: float, *, failed: bool) -> None:
        """Take note of a request: of an object, which may go in pieces, or of a page of a list."""

    def looked(self, *, found: bool) -> None:
        """Take note of a look for an object in the cache, and whether it was there."""


_watchers: list[StorageWatcher] = []
"""Of this process; one at most."""


def watch(watcher: StorageWatcher | None) -> None:
    """Tell somebody from now on; None: nobody."""
    _watchers[:] = [] if watcher is None else [watcher]


@contextmanager
def asking(operation: Operation) -> Iterator[None]:
    """Tell of the request in the block."""
    begun, failed = time.perf_counter(), True
    try:
        yield
        failed = False
    finally:
        for watcher in _watchers:
            watcher.asked(operation, time.perf_counter() - begun, failed=failed)


def tell_look(*, found: bool) -> None:
    """Tell of a look into the cache."""
    for watcher in _watchers:
        watcher.looked(found=found)
