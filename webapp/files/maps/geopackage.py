"""Reads the points of a GeoPackage that name photos; called in a process with limits (`webapp.files.gate`).

The file may be a stranger's. Views, virtual tables and triggers are in every GeoPackage with a spatial index,
so they are never used rather than refused: only plain tables are read, without computed columns, functions
and writing.
"""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from webapp.core.columns import PHOTO_FIELDS, read_header
from webapp.errors import TableError

MAGIC = b"SQLite format 3\0"

NOTES = (
    *("note", "notes", "comment", "comments", "remark", "remarks", "description"),
    *("bemerkung", "notiz", "kommentar", "beschreibung", "poznamka", "popis"),
    *("nota", "notas", "comentario", "descripcion", "remarque", "commentaire"),
)
"""Names of columns whose text becomes the note of a photo."""

_MOST_ROWS = 200_000
_MOST_VALUE = 1 << 20
"""Bytes of a value that is read: pictures in other columns are not."""

_MOST_NOTE, _MOST_NAME = 4000, 1000
_SAMPLE = 1000
"""Rows by which the column with the photos is chosen."""

_AT_ONCE = 500
_ENVELOPES = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}
"""Bytes of the envelope of a geometry, by the code in its flags."""

_READING = frozenset({sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ})


class _Column(NamedTuple):
    name: str
    is_text: bool


class _Layer(NamedTuple):
    table: str
    geometry: str
    photo: str
    heading: str | None
    note: str | None
    plane: str | None  # Coordinate system; None for longitude and latitude


def rows(path: str, suffixes: Sequence[str]) -> Iterator[bytes]:
    """Yield lists of points as JSON: the plane of their positions, and name, x, y, heading, note, where.

    Args:
        suffixes: File suffixes of photos, by which the column that names them is found.

    Raises:
        TableError: It is no GeoPackage, is damaged, or has more than tables where it is read.
    """
    address = f"{Path(path).absolute().as_uri()}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as connection:
            _guard(connection)
            yield from _Reader(connection, path, tuple(suffixes)).messages()
    except sqlite3.Error as error:
        raise TableError(
            f"the GeoPackage cannot be read: {str(error)[:200]}", where=path, hint="export the layer again"
        ) from error


def _guard(connection: sqlite3.Connection) -> None:
    """Limit what the content of a database can do while it is read."""
    for pragma in ("trusted_schema = OFF", "query_only = ON", "cell_size_check = ON"):
        connection.execute(f"PRAGMA {pragma}")
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_VALUE)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    connection.text_factory = lambda data: data.decode("utf-8", "replace")
    connection.set_authorizer(_authorize)


def _authorize(action: int, first: str | None, *others: str | None) -> int:
    """Allow reading columns of tables and listing them, but not to a view or a trigger, which come last."""
    listing = action == sqlite3.SQLITE_PRAGMA and first == "table_xinfo"
    allowed = others[-1] is None and (action in _READING or listing)
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


class _Reader:
    def __init__(self, connection: sqlite3.Connection, path: str, suffixes: tuple[str, ...]) -> None:
        self._connection, self._path, self._suffixes = connection, path, suffixes
        self._count = 0

    def messages(self) -> Iterator[bytes]:
        for layer in self._layers():
            found: list[list[object]] = []
            for entry in self._entries(layer):
                found.append(entry)
                if len(found) == _AT_ONCE:
                    yield json.dumps([layer.plane, found]).encode()
                    found = []
            yield json.dumps([layer.plane, found]).encode()

    def _layers(self) -> Iterator[_Layer]:
        for table in ("gpkg_contents", "gpkg_geometry_columns", "gpkg_spatial_ref_sys"):
            if not self._columns(table):
                raise TableError(
                    "this database is no GeoPackage", where=self._path, hint=f"it has no table {table}"
                )
        listed = self._connection.execute(
            "SELECT g.table_name, g.column_name, s.organization, s.organization_coordsys_id, s.definition"
            " FROM gpkg_contents AS c, gpkg_geometry_columns AS g, gpkg_spatial_ref_sys AS s"
            " WHERE c.data_type = 'features' AND g.table_name = c.table_name AND s.srs_id = g.srs_id"
        ).fetchall()
        for table, geometry, organization, code, definition in listed:
            columns = self._columns(str(table))
            photo = self._photo_column(str(table), columns)
            if photo is None or geometry not in [column.name for column in columns]:
                continue
            names = [column.name for column in columns if column.name not in (photo, geometry)]
            heading = next((name for name in names if _field(name) == "heading"), None)
            note = next((name for name in names if name.strip().lower() in NOTES), None)
            plane = _plane(str(organization), code, str(definition))
            yield _Layer(str(table), str(geometry), photo, heading, note, plane)

    def _columns(self, table: str) -> list[_Column]:
        """Return the columns of a table; none if the table is missing or a view."""
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name = ? AND rootpage > 0"
        if self._connection.execute(query, (table,)).fetchone() is None:
            return []
        found = self._connection.execute(f"PRAGMA table_xinfo({_quoted(table)})").fetchall()
        if any(hidden for *_, hidden in found):
            raise TableError(
                "the GeoPackage has a computed column",
                where=f"{self._path}: {table[:80]}",
                hint="export the layer again",
            )
        return [
            _Column(str(name), any(word in str(kind).upper() for word in ("TEXT", "CHAR")))
            for _, name, kind, *_ in found
        ]

    def _photo_column(self, table: str, columns: Sequence[_Column]) -> str | None:
        """Choose the column of texts with most names of photos, or else one with a usual header."""
        texts = [column.name for column in columns if column.is_text]
        if not texts:
            return None
        wanted = ", ".join(map(_quoted, texts))
        sample = self._connection.execute(
            f"SELECT {wanted} FROM {_quoted(table)} NOT INDEXED LIMIT {_SAMPLE}"
        )
        counts = [0] * len(texts)
        for values in sample:
            for index, value in enumerate(values):
                counts[index] += isinstance(value, str) and value.strip().lower().endswith(self._suffixes)
        most = max(range(len(texts)), key=counts.__getitem__)
        if counts[most]:
            return texts[most]
        return next((name for name in texts if _field(name) == "name"), None)

    def _entries(self, layer: _Layer) -> Iterator[list[object]]:
        wanted = [layer.geometry, layer.photo, layer.heading, layer.note]
        columns = ", ".join("NULL" if name is None else _quoted(name) for name in wanted)
        found = self._connection.execute(f"SELECT {columns} FROM {_quoted(layer.table)} NOT INDEXED")
        for number, (geometry, photo, heading, note) in enumerate(found, start=1):
            self._count += 1
            if self._count > _MOST_ROWS:
                raise TableError(
                    f"the GeoPackage has more than {_MOST_ROWS} points",
                    where=self._path,
                    hint="export a part of it",
                )
            at = _point(geometry)
            name = photo.strip().replace("\\", "/") if isinstance(photo, str) else ""
            if at is None or not name or len(name) > _MOST_NAME:
                continue
            turned = heading if isinstance(heading, int | float) and math.isfinite(heading) else None
            text = note[:_MOST_NOTE] if isinstance(note, str) else None
            yield [name, *at, turned, text, f"{self._path}: {layer.table[:80]}, row {number}"]


def _field(name: str) -> str | None:
    return read_header(name[:100], fields=PHOTO_FIELDS).field


def _plane(organization: str, code: object, definition: str) -> str | None:
    """Return a coordinate system as `parse_crs` takes it; None for longitude and latitude."""
    name = f"{organization.strip().upper()}:{code}"
    if name in ("EPSG:4326", "EPSG:4979", "OGC:CRS84", "NONE:0", "NONE:-1"):
        return None
    return name if organization.strip().upper() in ("EPSG", "ESRI", "IGNF") else definition


def _point(data: object) -> tuple[float, float] | None:
    """Return x and y of a point, or of the only one of several; None for other and for empty geometries."""
    if not isinstance(data, bytes) or len(data) < 8 or data[:2] != b"GP":
        return None
    envelope = _ENVELOPES.get(data[3] >> 1 & 7)
    if envelope is None or data[3] & 16:
        return None
    try:
        kind, at = _kind(data, 8 + envelope)
        if kind == 4 and struct.unpack_from("<I" if data[8 + envelope] else ">I", data, at) == (1,):
            kind, at = _kind(data, at + 4)
        if kind != 1:
            return None
        x, y = struct.unpack_from("<2d" if data[at - 5] else ">2d", data, at)
    except (struct.error, IndexError):
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def _kind(data: bytes, at: int) -> tuple[int, int]:
    """Return the code of a geometry in WKB, without its dimensions, and where its content begins."""
    (code,) = struct.unpack_from("<I" if data[at] else ">I", data, at + 1)
    return (code & 0x0FFFFFFF) % 1000, at + 5


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
