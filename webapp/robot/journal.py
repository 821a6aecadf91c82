"""A small file that only grows: each line says something that must not be forgotten."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from webapp.robot.disk import sync_folder, told, write_whole
from webapp.robot.frames import encode, lines, valid_end


class Journal:
    """Numbered JSON objects, one a line.

    Parameters
    ----------
    path : Path
        Is made where it is missing. What stands behind its last valid line was being written when the power
        went: it is cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        is_new = not path.exists()
        with told(path):
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644)
            self._end = valid_end(path)
            os.ftruncate(self._descriptor, self._end)
            if is_new:
                sync_folder(path.parent)
        self._count = sum(1 for _ in entries(path))

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._end

    def append(self, entry: dict[str, Any], *, sync: bool = True) -> None:
        """Add an entry; when this returns, it survives a kill, and with `sync` a power cut.

        Raises
        ------
        DiskFull, StorageError
            It was not added.
        """
        line = encode(self._count, as_text(entry))
        with told(self.path):
            append_at(self._descriptor, line, end=self._end)
            if sync:
                os.fsync(self._descriptor)
        self._end += len(line)
        self._count += 1

    def replace(self, entry: dict[str, Any]) -> None:
        """Forget all entries but this one."""
        line = encode(0, as_text(entry))
        self.close()
        with told(self.path):
            write_whole(self.path, line)
            self._descriptor = os.open(self.path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        self._end, self._count = len(line), 1

    def close(self) -> None:
        """Have all entries on the disk, and close the file."""
        os.fsync(self._descriptor)
        os.close(self._descriptor)


def entries(path: Path) -> Iterator[dict[str, Any]]:
    """Read what a journal says, in order; nothing where there is none. Damaged lines are left out."""
    if path.exists():
        for line in lines(path):
            if line.record is not None:
                yield json.loads(line.record.text)


def as_text(value: dict[str, Any]) -> bytes:
    """Write JSON on one line.

    Raises
    ------
    ValueError
        It holds a number that JSON has not, such as NaN.
    """
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode("utf-8")


def append_at(descriptor: int, data: bytes, *, end: int) -> None:
    """Write behind what is valid; what the disk did not take in full is taken back."""
    try:
        os.lseek(descriptor, end, os.SEEK_SET)
        view = memoryview(data)
        while view:
            view = view[os.write(descriptor, view) :]
    except OSError:
        os.ftruncate(descriptor, end)
        raise
