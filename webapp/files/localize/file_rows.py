"""Rows of an array that stay in their file: read when they are asked for, and not kept."""

from __future__ import annotations

import threading
import weakref
from io import FileIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.errors import IndexDamaged

_GAP_BYTES = 16_384
"""Rows that are nearer to each other in the file are read together."""


class OpenFile:
    """A file that several arrays are read from, by several threads.

    It stays readable when it is deleted; Windows does not delete it before it is closed.

    Parameters
    ----------
    file : FileIO
    repair : str
        How to fix it when it is damaged.
    """

    def __init__(self, file: FileIO, *, repair: str) -> None:
        self._file = file
        self._repair = repair
        self._lock = threading.Lock()
        weakref.finalize(self, file.close)

    def read(self, offset: int, into: NDArray[Any]) -> None:
        """Fill an array with what is from `offset` on.

        Raises
        ------
        IndexDamaged
            The file ends before, or cannot be read.
        """
        left = into.reshape(-1).view(np.uint8).data
        with self._lock:
            try:
                self._file.seek(offset)
                while len(left) and (count := self._file.readinto(left)):
                    left = left[count:]
            except OSError as error:
                raise self._damaged(f"it cannot be read: {error.strerror or error}") from error
        if len(left):
            raise self._damaged("it is cut off")

    def _damaged(self, what: str) -> IndexDamaged:
        return IndexDamaged(what, where=str(self._file.name), hint=self._repair)


class FileRows:
    """An array in a file, of which slices and some rows can be taken as of one in memory.

    Parameters
    ----------
    file : OpenFile
    offset : int
        Of the first row, bytes.
    dtype : dtype
    shape : tuple of int
    """

    def __init__(self, file: OpenFile, offset: int, *, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
        self._file = file
        self._offset = offset
        self.dtype = dtype
        self.shape = shape
        self.ndim = len(shape)
        self._row_bytes = dtype.itemsize * int(np.prod(shape[1:]))

    def __len__(self) -> int:
        """Count the rows."""
        return self.shape[0]

    def __getitem__(self, wanted: slice | NDArray[np.int64]) -> NDArray[Any]:
        """Read rows: of a slice without steps, or by their numbers, (m,) int64, none negative."""
        if isinstance(wanted, slice):
            first, stop, _ = wanted.indices(len(self))
            return self._read(first, max(first, stop))
        found = np.empty((len(wanted), *self.shape[1:]), self.dtype)
        order = np.argsort(wanted, kind="stable")
        ordered = wanted[order]
        breaks = np.flatnonzero(np.diff(ordered) * self._row_bytes > _GAP_BYTES) + 1
        for part in np.split(order, breaks):
            if len(part):
                first = int(wanted[part[0]])
                found[part] = self._read(first, int(wanted[part[-1]]) + 1)[wanted[part] - first]
        return found

    def _read(self, first: int, stop: int) -> NDArray[Any]:
        rows = np.empty((stop - first, *self.shape[1:]), self.dtype)
        self._file.read(self._offset + first * self._row_bytes, rows)
        return rows
