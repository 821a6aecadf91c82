"""Waiting for changes: watchers of a topic are woken when a transaction that announces it is committed."""

from __future__ import annotations

import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

_log = logging.getLogger(__name__)

CHANNEL = "expmap"
"""Channel of PostgreSQL (`NOTIFY`) on which topics are announced."""

_AGAIN_S = 1.0
_TURN_S = 0.5
"""Seconds after which the listener checks whether it was closed."""


class Watch(Protocol):
    def wait(self, seconds: float) -> bool:
        """Wait until it is time to look again, at most `seconds`; return whether a change was announced."""


class Polling:
    """Polls at an interval, for a database without announcements."""

    def __init__(self, look_s: float) -> None:
        self._look_s = look_s

    def wait(self, seconds: float) -> bool:
        """Wait for the interval, or for `seconds` if that is shorter."""
        time.sleep(min(self._look_s, seconds))
        return False


class Listener:
    """Receives the announcements of a PostgreSQL database, for all threads of a process.

    Args:
        connect: Opens a connection of psycopg in autocommit mode.
        error: Base class of the errors of psycopg.
    """

    def __init__(self, connect: Callable[[], Any], *, error: type[Exception]) -> None:
        self._connect = connect
        self._errors = (error, DBAPIError, PoolTimeout)
        self._lock = threading.Lock()
        self._waiting: dict[str, set[threading.Event]] = defaultdict(set)
        self._listening = False
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()

    @contextmanager
    def watch(self, topic: str, *, look_s: float) -> Iterator[Watch]:
        woken = threading.Event()
        with self._lock:
            self._waiting[topic].add(woken)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="listener", daemon=True)
                self._thread.start()
        try:
            yield _Listening(self, woken, look_s)
        finally:
            with self._lock:
                self._waiting[topic].discard(woken)
                if not self._waiting[topic]:
                    del self._waiting[topic]

    @property
    def listening(self) -> bool:
        """Whether announcements are received; otherwise watchers have to poll."""
        return self._listening

    def close(self) -> None:
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                self._listen()
            except self._errors as error:
                _log.info("changes are not heard of for a moment: %s", str(error).partition("\n")[0])
            finally:
                self._listening = False
                self._wake_all()
            self._closed.wait(_AGAIN_S)

    def _listen(self) -> None:
        connection = self._connect()
        try:
            connection.execute(f"LISTEN {CHANNEL}")
            self._listening = True
            self._wake_all()  # something may have been announced before
            while not self._closed.is_set():
                for notice in connection.notifies(timeout=_TURN_S):
                    self._wake(notice.payload)
        finally:
            connection.close()

    def _wake(self, topic: str) -> None:
        with self._lock:
            for woken in self._waiting.get(topic, ()):
                woken.set()

    def _wake_all(self) -> None:
        with self._lock:
            for woken in set().union(*self._waiting.values()):
                woken.set()


class _Listening:
    """Waits for an announcement, and polls while none can be received."""

    def __init__(self, listener: Listener, woken: threading.Event, look_s: float) -> None:
        self._listener, self._woken, self._look_s = listener, woken, look_s

    def wait(self, seconds: float) -> bool:
        """Wait, at least for the pause between two looks."""
        until = time.monotonic() + seconds
        time.sleep(min(self._look_s, seconds))
        if self._listener.listening:
            self._woken.wait(max(until - time.monotonic(), 0.0))
        woken = self._woken.is_set()
        self._woken.clear()
        return woken
