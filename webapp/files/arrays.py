"""Named arrays in one file that is read by memory map: the container of features and segments.

Layout: 8 bytes magic, 8 bytes length of the header (little-endian), a JSON header with the arrays' names,
types, shapes and offsets and the file's size, then the arrays, each starting at a multiple of 64 bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.errors import IndexDamaged
from webapp.files import atomic

_MAGIC = b"EXPMAP1\n"
_ALIGN = 64


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, meta: Mapping[str, Any]) -> str:
    """Write arrays and a JSON-able header to a file, whole or not at all.

    Parameters
    ----------
    path : Path
        May hold `{hash}`, which becomes the first 16 characters of the content's SHA-256.
    arrays : mapping of str to array
    meta : mapping
        Kept in the header.

    Returns
    -------
    str
        Those 16 characters.

    Raises
    ------
    StorageError
    """
    data = _to_bytes(arrays, meta)
    digest = hashlib.sha256(data).hexdigest()[:16]
    atomic.write_bytes(path.with_name(path.name.replace("{hash}", digest)), data)
    return digest


def read_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Open a file of `write_arrays`; the arrays are read-only memory maps.

    Returns
    -------
    arrays : dict of str to array
    meta : dict

    Raises
    ------
    IndexDamaged
        The file is missing, cut off, or not such a file.
    """
    try:
        with path.open("rb") as file:
            start = file.read(16)
            length = int.from_bytes(start[8:16], "little")
            if start[:8] != _MAGIC or length > path.stat().st_size:
                raise IndexDamaged("not a file of arrays", where=str(path))
            header = json.loads(file.read(length))
        if path.stat().st_size != header["bytes"]:
            raise IndexDamaged("the file is cut off", where=str(path))
        data = np.memmap(path, np.uint8, "r")
    except (OSError, ValueError, KeyError) as error:
        raise IndexDamaged(f"cannot be read: {error}", where=str(path)) from error
    return {a["name"]: _view(data, a) for a in header["arrays"]}, header["meta"]


def _view(data: NDArray[np.uint8], entry: dict[str, Any]) -> NDArray[Any]:
    dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
    size = dtype.itemsize * int(np.prod(shape))
    view: NDArray[Any] = data[entry["offset"] : entry["offset"] + size].view(dtype).reshape(shape)
    return view


def _to_bytes(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> bytes:
    plain = {name: np.ascontiguousarray(a) for name, a in arrays.items()}
    # Offsets depend on the header's length and the header on the offsets: reserve room for long numbers.
    room = _aligned(
        16 + len(json.dumps([meta, [(n, str(a.dtype), a.shape) for n, a in plain.items()]])) + 512
    )
    room += 160 * len(plain)
    offset, entries = _aligned(room), []
    for name, array in plain.items():
        entries.append({"name": name, "dtype": array.dtype.str, "shape": array.shape, "offset": offset})
        offset = _aligned(offset + array.nbytes)
    header = json.dumps({"bytes": offset, "arrays": entries, "meta": dict(meta)}, sort_keys=True).encode()
    parts = [_MAGIC, len(header).to_bytes(8, "little"), header]
    parts.append(bytes(_aligned(room) - 16 - len(header)))
    for array in plain.values():
        parts += [array.tobytes(), bytes(_aligned(array.nbytes) - array.nbytes)]
    return b"".join(parts)


def _aligned(size: int) -> int:
    return -(-size // _ALIGN) * _ALIGN
