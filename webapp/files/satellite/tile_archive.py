"""Reads files of map tiles, MBTiles and PMTiles with pictures, in the standard grid of Web Mercator."""

from __future__ import annotations

import mmap
import sqlite3
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Protocol

from webapp.errors import InputError, StorageError
from webapp.extras import extra

PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
"""Media types by the first bytes."""

_SQLITE = b"SQLite format 3\0"
_PMTILES = b"PMTiles\x03"
_GZIP = b"\x1f\x8b"
_LARGEST_DIRECTORY = 16_000_000
"""Bytes of a directory of PMTiles."""


class TileArchive(Protocol):
    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """Return a picture; None where there is none. Rows count from the north."""


@contextmanager
def opened_tiles(path: Path) -> Iterator[TileArchive]:
    """Open a file of tiles, recognised by content.

    Raises:
        InputError: It is neither MBTiles nor PMTiles of version 3, is damaged or has no pictures; also later,
            when a tile is read.
        StorageError: It cannot be read.
        MissingPart: It is PMTiles, and the package is not installed.
    """
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise StorageError(f"the tiles cannot be read: {error.strerror}", where=path.name) from error
    if head.startswith(_SQLITE):
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
            yield _MbTiles(connection, path.name)
    elif head.startswith(_PMTILES):
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            yield opened_pmtiles(lambda offset, length: content[offset : offset + length], name=path.name)
    else:
        raise InputError(
            "this is neither MBTiles nor PMTiles of version 3",
            where=path.name,
            hint="convert it with the program pmtiles, or with GDAL",
        )


class _MbTiles:
    def __init__(self, connection: sqlite3.Connection, name: str) -> None:
        self._connection, self._name = connection, name
        connection.execute("PRAGMA query_only = ON")
        connection.execute("PRAGMA trusted_schema = OFF")

    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        row = (1 << zoom) - 1 - y  # MBTiles count from the south
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        try:
            found = self._connection.execute(query, (zoom, x, row)).fetchone()
        except sqlite3.Error as error:
            raise _damaged(error, self._name) from error
        return None if found is None else _picture(found[0], self._name)


def opened_pmtiles(part: Callable[[int, int], bytes], *, name: str) -> TileArchive:
    """Read PMTiles from any source.

    Args:
        part: Returns some bytes, given their offset and number.
        name: Of the file, for errors.

    Raises:
        MissingPart: The package is not installed.
    """
    return _PmTiles(part, name)


class _PmTiles:
    def __init__(self, part: Callable[[int, int], bytes], name: str) -> None:
        with extra("connect"):
            from pmtiles.reader import Reader
        self._reader = Reader(lambda offset, length: _not_swelling(part(offset, length)))
        self._name = name

    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        try:
            found = self._reader.get(zoom, x, y)
        except (ValueError, IndexError, KeyError, EOFError, OSError, zlib.error) as error:
            raise _damaged(error, self._name) from error
        return None if found is None else _picture(found, self._name)


def _not_swelling(data: bytes) -> bytes:
    """Return a part of PMTiles; refuse a compressed directory that takes far too much memory."""
    if data.startswith(_GZIP):
        unpacker = zlib.decompressobj(wbits=31)
        unpacker.decompress(data, _LARGEST_DIRECTORY)
        if unpacker.unconsumed_tail:
            raise ValueError("a directory is too large")
    return data


def _picture(data: object, name: str) -> bytes:
    if isinstance(data, bytes) and data.startswith(tuple(PICTURES)):
        return data
    raise InputError(
        "its tiles are no PNG, JPEG or WebP pictures", where=name, hint="vector tiles cannot be shown"
    )


def _damaged(error: Exception, name: str) -> InputError:
    return InputError(f"the tiles are damaged: {str(error)[:200]}", where=name, hint="copy the file again")
