"""A lock that dies with its process: by it workers know which others of their machine still live."""

from __future__ import annotations

import os
import secrets
import socket
from pathlib import Path

from filelock import FileLock, Timeout


class ProcessLock:
    """A worker's name, with a locked file of that name as long as its process lives.

    The system frees the lock however the process ends; unlike a process id, a name never comes back.

    Parameters
    ----------
    folder : Path
        Where the workers of a library have their files.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._host = f"{socket.gethostname()}:"
        self.name = f"{self._host}{os.getpid()}:{secrets.token_hex(4)}"
        self._lock = FileLock(self._path(self.name), timeout=0)
        self._lock.acquire()

    def is_gone(self, name: str) -> bool:
        """Check whether a worker of this machine has ended; False for other machines, which is unknown."""
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
        """Free the lock and delete its file."""
        self._lock.release()
        self._path(self.name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self._folder / (name.removeprefix(self._host).replace(":", "-") + ".lock")
