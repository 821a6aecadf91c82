"""Health checks of a server, as `/healthz`, `/livez` and `/readyz` report them, and what they look at.

A pipe signals to the processes of a server that it is about to stop, before they get SIGTERM: the supervisor
holds the write end. When it is closed, also by the supervisor's death, all processes that inherited the read
end notice it, even those that were restarted. The lock of a worker shows whether its process lives.
"""

from __future__ import annotations

import os
import secrets
import select
import shutil
import socket
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Self

from filelock import FileLock, Timeout
from sqlalchemy import text

from webapp.configuration import DRAINING_FD, draining_fd
from webapp.errors import StorageError
from webapp.files.contents import in_use
from webapp.files.lock import any_alive
from webapp.settings import Settings
from webapp.store.library import Library, has_library


class Drain:
    """The supervisor's side; a context manager that closes the pipe."""

    def __init__(self) -> None:
        self.reading_end, self._writing_end = os.pipe()
        self._begun = False

    @property
    def environment(self) -> dict[str, str]:
        """Environment for processes that inherit the read end."""
        return {DRAINING_FD: str(self.reading_end)}

    def has_begun(self) -> bool:
        """Return whether the server is about to stop."""
        return self._begun

    def begin(self) -> None:
        if not self._begun:
            self._begun = True
            os.close(self._writing_end)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.begin()
        os.close(self.reading_end)


def is_draining() -> bool:
    """Return whether the server of this process is about to stop; False if it has no supervisor."""
    number = draining_fd()
    if number is None:
        return False
    look = select.poll()
    look.register(number, select.POLLIN)
    return any(happened & select.POLLHUP for _, happened in look.poll(0))


Report = tuple[dict[str, str], HTTPStatus]
_WORDS = {True: "ok", False: "failing"}
_READ_ONLY = "read-only"
_STATUSES = {True: HTTPStatus.OK, False: HTTPStatus.SERVICE_UNAVAILABLE}


@dataclass(frozen=True, slots=True)
class Health:
    library: Library
    settings: Settings
    draining: Callable[[], bool] = is_draining  # Returns whether the server is about to stop
    # Returns whether its web processes take new connections.
    takes_requests: Callable[[], bool] = lambda: True

    def live(self) -> Report:
        """Liveness probe: always answers 200; if there is no response, the server may be restarted."""
        return {"status": "ok"}, HTTPStatus.OK

    def ready(self) -> Report:
        """Readiness probe: answers 200 to receive requests, 503 if other servers of the library should.

        Shared services, such as the database, are not checked: their failure would make all servers unready.
        A disk that is read-only is stated: what is there can be read.
        """
        if self.draining():
            return {"status": "draining"}, HTTPStatus.SERVICE_UNAVAILABLE
        well = self.takes_requests() and (self.settings.database is None or has_library(self.library.folder))
        disk = {"disk": _READ_ONLY} if self._is_read_only() else {}
        return {"status": _WORDS[well], **disk}, _STATUSES[well]

    def whole(self) -> Report:
        """Health check for monitoring: answers 503 if anything fails, including shared services, else 200."""
        parts = {
            "web": self.takes_requests(),
            "database": self._database_answers(),
            "disk": self._disk_has_room() and not self._is_read_only(),
        }
        if self.settings.serve.job_workers:
            parts["worker"] = any_alive(self.library.inner / "workers", but=SHORT_LOCKS)
        if self.settings.database is not None:
            parts["folder"] = has_library(self.library.folder)
        storage = in_use()
        if storage is not None:
            parts["storage"] = storage.reachable()
        well, draining = all(parts.values()), self.draining()
        states = {name: _WORDS[state] for name, state in parts.items()}
        if self._is_read_only():
            states["disk"] = _READ_ONLY
        return {"status": "draining" if draining else _WORDS[well], **states}, _STATUSES[
            well and not draining
        ]

    def _database_answers(self) -> bool:
        try:
            with self.library.database.read() as session:
                session.execute(text("SELECT 1 FROM map LIMIT 1"))
        except StorageError:
            return False
        return True

    def _is_read_only(self) -> bool:
        return has_library(self.library.folder) and not os.access(self.library.inner, os.W_OK)

    def _disk_has_room(self) -> bool:
        """Return whether there is enough free space for uploads."""
        try:
            free = shutil.disk_usage(self.library.folder).free
        except OSError:
            return False
        return free >= self.settings.upload.reserve_mb * 1e6


PROBES: dict[str, Callable[[Health], Report]] = {
    "healthz": Health.whole,
    "livez": Health.live,
    "readyz": Health.ready,
}
"""The probes by the paths at which they are answered."""


SHORT_LOCKS = "*-short.lock"
"""Lock files of workers that do only short jobs."""


class ProcessLock:
    """A worker's unique name, and a file of that name that stays locked while its process lives.

    The system frees the lock however the process ends; unlike process ids, names are never reused.

    Args:
        short: Whether the worker does only short jobs.
    """

    def __init__(self, folder: Path, *, short: bool = False) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._host = f"{socket.gethostname()}:"
        self.name = f"{self._host}{os.getpid()}:{secrets.token_hex(4)}{':short' if short else ''}"
        self._lock = FileLock(self._path(self.name), timeout=0)
        self._lock.acquire()

    def is_gone(self, name: str) -> bool:
        """Check whether a worker of this machine has ended; False for other machines, where it is unknown."""
        if name == self.name or not name.startswith(self._host):
            return False
        path = self._path(name)
        if not path.exists():
            return True
        try:
            FileLock(path, timeout=0).acquire().lock.release()
        except Timeout:
            return False
        path.unlink(missing_ok=True)
        return True

    def release(self) -> None:
        self._lock.release()
        self._path(self.name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self._folder / (name.removeprefix(self._host).replace(":", "-") + ".lock")
