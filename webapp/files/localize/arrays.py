"""Named arrays in one file that can be memory-mapped: the container of features and segments.

Layout: 8 bytes magic, 8 bytes length of the header (little-endian), a JSON header with the arrays' names,
types, shapes and offsets and the file's size, then the arrays, each starting at a multiple of 64 bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import threading
import weakref
import zlib
from collections.abc import Collection, Mapping
from io import FileIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from webapp.errors import IndexDamaged, ObjectLost
from webapp.files import atomic
from webapp.files.contents import local, replaced, settle
from webapp.files.sealed import sealed, unsealed

_GAP_BYTES = 16_384
"""Rows closer to each other in the file are read in one go."""


class OpenFile:
    """An open file from which several arrays are read, by several threads.

    It stays readable after its deletion; on Windows it cannot be deleted before it is closed.
    """

    def __init__(self, file: FileIO, *, repair: str) -> None:
        self._file = file
        self._repair = repair
        self._lock = threading.Lock()
        weakref.finalize(self, file.close)

    def read(self, offset: int, into: NDArray[Any]) -> None:
        """Fill an array with the bytes from `offset` on."""
        left = into.reshape(-1).view(np.uint8).data
        with self._lock:
            try:
                self._file.seek(offset)
                while len(left) and (count := self._file.readinto(left)):
                    left = left[count:]
            except OSError as error:
                raise self._damaged(f"it cannot be read: {error.strerror or error}") from error
        if len(left):
            raise self._damaged("it is truncated")

    def _damaged(self, what: str) -> IndexDamaged:
        return IndexDamaged(what, where=str(self._file.name), hint=self._repair)


class FileRows:
    """An array in a file, whose rows can be sliced and indexed like those of one in memory.

    Args:
        offset: Position of the first row, bytes.
    """

    def __init__(self, file: OpenFile, offset: int, *, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
        self._file = file
        self._offset = offset
        self.dtype = dtype
        self.shape = shape
        self.ndim = len(shape)
        self._row_bytes = dtype.itemsize * int(np.prod(shape[1:]))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, wanted: slice | NDArray[np.int64]) -> NDArray[Any]:
        """Read rows: a slice without a step, or by their numbers, (m,) int64, none negative."""
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


_MAGIC = b"EXPMAP1\n"
_ALIGN = 64

REPAIR = "run expmap build with the same options to recompute what is damaged"
"""How to fix a damaged file of an index."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, meta: Mapping[str, Any]) -> str:
    """Write arrays and a JSON header to a file atomically. Raises StorageError.

    Args:
        path: May contain `{hash}`, which becomes the first 16 characters of the content's SHA-256.
        meta: JSON values for the header.
    """
    parts = _parts(arrays, meta)
    content = hashlib.sha256()
    for part in parts:
        content.update(part)
    digest = content.hexdigest()[:16]
    target = path.with_name(path.name.replace("{hash}", digest))
    atomic.write_bytes(target, *parts)
    replaced(target)
    return digest


def write_settled(path: Path, arrays: Mapping[str, NDArray[Any]], *, meta: Mapping[str, Any]) -> None:
    """Write a file like `write_arrays`, then settle it: it becomes an object if the library has a storage.

    Raises:
        StorageError: The disk or the storage failed; in the latter case the file is on the disk.
    """
    write_arrays(path, arrays, meta=meta)
    settle(path)


def read_arrays(
    path: Path, *, mapped: bool = True, in_file: Collection[str] = (), verify: bool | None = None
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Open a file written by `write_arrays`.

    Args:
        mapped: Whether the arrays are read-only memory maps, which keep the file open, or read into memory.
        in_file: Arrays to leave in the file: each is a `FileRows`, which keeps the file open. If there are
            any, all others are read into memory.
        verify: Whether the checksums of the arrays are compared, which reads all of them; by default, if they
            are read into memory anyway.

    Raises:
        IndexDamaged: The file is missing, truncated, of another kind, or does not match its checksums.
        StorageError: The file is an object, and the storage or the disk of the cache failed.
    """
    path = present(path)
    try:
        with path.open("rb") as file:
            start = file.read(16)
            length = int.from_bytes(start[8:16], "little")
            if start[:8] != _MAGIC or length > path.stat().st_size:
                raise _damaged("it is not a file of arrays", path)
            header = unsealed(file.read(length))
        if path.stat().st_size != header["bytes"]:
            raise _damaged("it is truncated", path)
        if in_file:
            return _read_some(path, header["arrays"], in_file), dict(header["meta"])
        data = np.memmap(path, np.uint8, "r") if mapped else np.fromfile(path, np.uint8)
        arrays = {a["name"]: _view(data, a) for a in header["arrays"]}
        if (not mapped if verify is None else verify) and not _as_written(arrays, header["arrays"]):
            raise _damaged("its content differs from its checksums", path)
        return arrays, dict(header["meta"])
    except OSError as error:
        raise _damaged(f"it cannot be read: {error.strerror or error}", path) from error
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged("its header is damaged", path) from error


def present(path: Path) -> Path:
    """Return where a file of an index can be read; an object is fetched first.

    Raises:
        IndexDamaged: The storage has lost the object.
        StorageError: The storage or the disk of the cache failed.
    """
    try:
        return local(path)
    except ObjectLost as error:
        raise IndexDamaged(error.message, where=str(path), hint=REPAIR) from error


def _read_some(
    path: Path, entries: list[dict[str, Any]], in_file: Collection[str]
) -> dict[str, NDArray[Any]]:
    file = OpenFile(path.open("rb", buffering=0), repair=REPAIR)
    arrays: dict[str, NDArray[Any]] = {}
    for entry in entries:
        offset, dtype, shape = _layout(entry)
        rows = FileRows(file, offset, dtype=dtype, shape=shape)
        # FileRows supports all operations that are used on these arrays.
        arrays[entry["name"]] = cast("NDArray[Any]", rows) if entry["name"] in in_file else rows[:]
    return arrays


def _damaged(what: str, path: Path) -> IndexDamaged:
    return IndexDamaged(what, where=str(path), hint=REPAIR)


def _layout(entry: dict[str, Any]) -> tuple[int, np.dtype[Any], tuple[int, ...]]:
    dtype, shape, offset = np.dtype(entry["dtype"]), tuple(entry["shape"]), entry["offset"]
    if offset < 0 or any(side < 0 for side in shape):
        raise ValueError(entry)
    return offset, dtype, shape


def _view(data: NDArray[np.uint8], entry: dict[str, Any]) -> NDArray[Any]:
    offset, dtype, shape = _layout(entry)
    size = dtype.itemsize * math.prod(shape)
    view: NDArray[Any] = data[offset : offset + size].view(dtype).reshape(shape)
    return view


def _as_written(arrays: Mapping[str, NDArray[Any]], entries: list[dict[str, Any]]) -> bool:
    """Compare the checksums, which files of older programs do not have."""
    return all(zlib.crc32(_bytes_of(arrays[e["name"]])) == e["crc32"] for e in entries if "crc32" in e)


def _parts(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> list[bytes | memoryview]:
    """Return the parts of a file; contiguous arrays are not copied."""
    plain = {name: np.ascontiguousarray(a) for name, a in arrays.items()}
    # Offsets depend on the header's length and the header on the offsets: reserve space for long numbers.
    room = _aligned(
        16 + len(json.dumps([meta, [(n, str(a.dtype), a.shape) for n, a in plain.items()]])) + 512
    )
    room += 160 * len(plain)
    offset, entries = _aligned(room), []
    for name, array in plain.items():
        entry = {"name": name, "dtype": array.dtype.str, "shape": array.shape, "offset": offset}
        entries.append(entry | {"crc32": zlib.crc32(_bytes_of(array))})
        offset = _aligned(offset + array.nbytes)
    header = sealed({"bytes": offset, "arrays": entries, "meta": dict(meta)})
    parts: list[bytes | memoryview] = [_MAGIC, len(header).to_bytes(8, "little"), header]
    parts.append(bytes(_aligned(room) - 16 - len(header)))
    for array in plain.values():
        parts += [_bytes_of(array), bytes(_aligned(array.nbytes) - array.nbytes)]
    return parts


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


def _aligned(size: int) -> int:
    return -(-size // _ALIGN) * _ALIGN
