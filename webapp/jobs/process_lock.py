"""The name of a worker, and the lock that shows whether its process lives."""

from __future__ import annotations

import os
import secrets
import socket
from pathlib import Path

from filelock import FileLock, Timeout

SHORT_LOCKS = "*-short.lock"
"""Lock files of workers that do only short jobs."""


class ProcessLock:
    """A worker's unique name, and a file of that name that stays locked while its process lives.

    The system frees the lock however the process ends; unlike process ids, names are never reused.

    Args:
        folder: Folder with the lock files of a library's workers.
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
        """Release the lock and delete its file."""
        self._lock.release()
        self._path(self.name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self._folder / (name.removeprefix(self._host).replace(":", "-") + ".lock")
