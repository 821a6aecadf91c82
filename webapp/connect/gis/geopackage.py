"""Writes GeoPackage 1.3 (OGC 12-128r17): tables of features in WGS 84 with descriptions, styles and media."""

from __future__ import annotations

import math
import secrets
import sqlite3
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.files.atomic import storage_error

_APPLICATION_ID = 0x47504B47  # "GPKG"
_VERSION = 10300
_WGS84 = 4326
_GEOMETRY = "geom"
_CODES = {"POINT": 1, "LINESTRING": 2, "POLYGON": 3, "MULTILINESTRING": 5}
_Z, _M = 1000, 2000
"""What ISO WKB adds to the code of a geometry with heights, and with measures."""

_HEAD = struct.Struct("<2sBBi")
_EMPTY_FLAGS, _XY_FLAGS = 0b00001, 0b00011
"""Little-endian; without an envelope, and with one of minimum and maximum x and y."""

_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
    'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]'
)
_SYSTEMS = (
    ("Undefined Cartesian", -1, "NONE", -1, "undefined"),
    ("Undefined geographic", 0, "NONE", 0, "undefined"),
    ("WGS 84", _WGS84, "EPSG", _WGS84, _WKT),
)

_SCHEMA = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
  description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
  identifier TEXT UNIQUE, description TEXT DEFAULT '',
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
  geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL,
  definition TEXT NOT NULL, scope TEXT NOT NULL,
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
CREATE TABLE gpkg_data_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT,
  description TEXT, mime_type TEXT, constraint_name TEXT,
  CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name), CONSTRAINT gdc_tn UNIQUE (table_name, name));
CREATE TABLE gpkg_data_column_constraints (constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL,
  value TEXT, min NUMERIC, min_is_inclusive BOOLEAN, max NUMERIC, max_is_inclusive BOOLEAN,
  description TEXT, CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value));
CREATE TABLE layer_styles (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30),
  styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30),
  update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')));
INSERT INTO gpkg_contents (table_name, data_type, identifier, description)
  VALUES ('layer_styles', 'attributes', 'layer_styles', 'Styles of the layers, for QGIS');
"""
_MEDIA_SCHEMA = """
CREATE TABLE gpkgext_relations (id INTEGER PRIMARY KEY AUTOINCREMENT, base_table_name TEXT NOT NULL,
  base_primary_column TEXT NOT NULL DEFAULT 'id', related_table_name TEXT NOT NULL,
  related_primary_column TEXT NOT NULL DEFAULT 'id', relation_name TEXT NOT NULL,
  mapping_table_name TEXT NOT NULL UNIQUE);
CREATE TABLE pictures (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, data BLOB NOT NULL,
  content_type TEXT NOT NULL);
INSERT INTO gpkg_contents (table_name, data_type, identifier, description)
  VALUES ('pictures', 'attributes', 'pictures', 'Pictures of the features');
"""
_INDEX_EXTENSION = "http://www.geopackage.org/spec120/#extension_rtree"
_INDEX = "rtree_{t}_geom"
_BOX = "ST_MinX(NEW.geom), ST_MaxX(NEW.geom), ST_MinY(NEW.geom), ST_MaxY(NEW.geom)"
_THERE, _NOT_THERE = (
    "NEW.geom NOTNULL AND NOT ST_IsEmpty(NEW.geom)",
    "(NEW.geom ISNULL OR ST_IsEmpty(NEW.geom))",
)
_TRIGGERS = {
    "insert": f"INSERT ON {{t}} WHEN {_THERE} BEGIN INSERT OR REPLACE INTO {{i}} VALUES (NEW.fid, {_BOX});",
    "update2": f"UPDATE OF geom ON {{t}} WHEN OLD.fid = NEW.fid AND {_NOT_THERE}"
    " BEGIN DELETE FROM {i} WHERE id = OLD.fid;",
    "update4": f"UPDATE ON {{t}} WHEN OLD.fid != NEW.fid AND {_NOT_THERE}"
    " BEGIN DELETE FROM {i} WHERE id IN (OLD.fid, NEW.fid);",
    "update5": f"UPDATE ON {{t}} WHEN OLD.fid != NEW.fid AND {_THERE} BEGIN DELETE FROM {{i}}"
    f" WHERE id = OLD.fid; INSERT OR REPLACE INTO {{i}} VALUES (NEW.fid, {_BOX});",
    "update6": f"UPDATE OF geom ON {{t}} WHEN OLD.fid = NEW.fid AND {_THERE} AND OLD.geom NOTNULL AND"
    " NOT ST_IsEmpty(OLD.geom) BEGIN UPDATE {i} SET minx = ST_MinX(NEW.geom), maxx = ST_MaxX(NEW.geom),"
    " miny = ST_MinY(NEW.geom), maxy = ST_MaxY(NEW.geom) WHERE id = NEW.fid;",
    "update7": f"UPDATE OF geom ON {{t}} WHEN OLD.fid = NEW.fid AND {_THERE} AND"
    f" (OLD.geom ISNULL OR ST_IsEmpty(OLD.geom)) BEGIN INSERT INTO {{i}} VALUES (NEW.fid, {_BOX});",
    "delete": "DELETE ON {t} WHEN OLD.geom NOTNULL BEGIN DELETE FROM {i} WHERE id = OLD.fid;",
}
"""What keeps the index right while other programs, which have the functions ST_..., change the table."""

_SCHEMA_EXTENSION = "http://www.geopackage.org/spec/#extension_schema"
_MEDIA_EXTENSION = "http://www.geopackage.org/18-000.html"


class Geometry(NamedTuple):
    """A geometry as it is stored, and its bounds: west, south, east, north."""

    data: bytes
    bounds: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class TableField:
    """A column of a table."""

    name: str
    type: Literal["TEXT", "INTEGER", "REAL", "DATETIME", "BOOLEAN"]
    about: str


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """A table of features, which GIS programs show as a layer."""

    name: str
    about: str
    geometry: Literal["POINT", "POLYGON", "MULTILINESTRING"]
    fields: tuple[TableField, ...]
    style: str  # QML, as QGIS reads it
    has_z: bool = False  # Whether geometries may have heights
    has_m: bool = False  # Whether geometries may have measures


def point(at: LatLon, height_m: float | None = None) -> Geometry:
    """Make a point."""
    x, y = at.lon, at.lat
    if height_m is None or math.isnan(height_m):
        wkb = struct.pack("<BI2d", 1, _CODES["POINT"], x, y)
    else:
        wkb = struct.pack("<BI3d", 1, _CODES["POINT"] + _Z, x, y, height_m)
    return Geometry(_HEAD.pack(b"GP", 0, _EMPTY_FLAGS, _WGS84) + wkb, (x, y, x, y))


def polygon(ring: ArrayLike) -> Geometry:
    """Make a polygon without holes from the latitudes and longitudes of its corners, (n, 2)."""
    corners = np.asarray(ring, np.float64)[:, ::-1]
    closed = np.vstack([corners, corners[:1]])
    wkb = struct.pack("<BIII", 1, _CODES["POLYGON"], 1, len(closed)) + closed.tobytes()
    return _with_envelope(wkb, closed)


def lines(parts: Sequence[NDArray[np.float64]], *, has_z: bool, has_m: bool) -> Geometry:
    """Make a geometry of several lines.

    Args:
        parts: (n, 2) to (n, 4) each, n >= 2. Longitude, latitude, height, measure: the last two if the
            geometry has them.
    """
    more = _Z * has_z + _M * has_m
    wkb = [struct.pack("<BII", 1, _CODES["MULTILINESTRING"] + more, len(parts))]
    for part in parts:
        wkb += [struct.pack("<BII", 1, _CODES["LINESTRING"] + more, len(part)), part.tobytes()]
    return _with_envelope(b"".join(wkb), np.vstack([part[:, :2] for part in parts]))


def _with_envelope(wkb: bytes, points: NDArray[np.float64]) -> Geometry:
    (west, south), (east, north) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    head = _HEAD.pack(b"GP", 0, _XY_FLAGS, _WGS84) + struct.pack("<4d", west, east, south, north)
    return Geometry(head + wkb, (west, south, east, north))


class GeoPackage:
    """A GeoPackage that is being written.

    Args:
        connection: An empty database; the caller commits and closes it.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        connection.executescript(
            f"PRAGMA application_id = {_APPLICATION_ID}; PRAGMA user_version = {_VERSION}; {_SCHEMA}"
        )
        insert = "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, NULL)"
        connection.executemany(insert, _SYSTEMS)
        for table in ("gpkg_data_columns", "gpkg_data_column_constraints"):
            self._extend(table, "gpkg_schema", _SCHEMA_EXTENSION)
        self._media: set[str] = set()

    def add(
        self, table: FeatureTable, rows: Iterable[tuple[Geometry | None, Sequence[Any]]], *, title: str
    ) -> int:
        """Write a table of features, which get ids from 1, in their order; return their number.

        Args:
            rows: Geometry, None where it is unknown; and a value for each field, None where it is unknown.
            title: Name of the layer; unique in the file.
        """
        self._create(table, title=title)
        marks = ", ".join("?" * (1 + len(table.fields)))
        names = ", ".join(f'"{name}"' for name in (_GEOMETRY, *(field.name for field in table.fields)))
        insert = f'INSERT INTO "{table.name}" ({names}) VALUES ({marks})'
        index = f"INSERT INTO {_INDEX.format(t=table.name)} VALUES (?, ?, ?, ?, ?)"
        west, south, east, north = math.inf, math.inf, -math.inf, -math.inf
        count = 0
        for count, (geometry, values) in enumerate(rows, start=1):
            data = None if geometry is None else geometry.data
            self._connection.execute(insert, (data, *map(_plain, values)))
            if geometry is not None:
                left, bottom, right, top = geometry.bounds
                west, south, east, north = (
                    min(west, left),
                    min(south, bottom),
                    max(east, right),
                    max(north, top),
                )
                self._connection.execute(index, (count, left, right, bottom, top))
        self._keep_indexed(table.name)
        if west <= east:
            self._connection.execute(
                "UPDATE gpkg_contents SET min_x = ?, min_y = ?, max_x = ?, max_y = ? WHERE table_name = ?",
                (west, south, east, north, table.name),
            )
        return count

    def attach(self, table: FeatureTable, number: int, *, jpeg: bytes) -> None:
        """Store a picture of the feature with that id (Related Tables Extension, OGC 18-000)."""
        mapping = f"{table.name}_pictures"
        if table.name not in self._media:
            self._relate(table.name, mapping)
            self._media.add(table.name)
        insert = "INSERT INTO pictures (data, content_type) VALUES (?, 'image/jpeg')"
        picture = self._connection.execute(insert, (jpeg,)).lastrowid
        self._connection.execute(f'INSERT INTO "{mapping}" VALUES (?, ?)', (number, picture))

    def _create(self, table: FeatureTable, *, title: str) -> None:
        columns = [
            "fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL",
            f"{_GEOMETRY} {table.geometry}",
            *(f'"{field.name}" {field.type}' for field in table.fields),
        ]
        execute = self._connection.execute
        execute(f'CREATE TABLE "{table.name}" ({", ".join(columns)})')
        execute(f"CREATE VIRTUAL TABLE {_INDEX.format(t=table.name)} USING rtree(id, minx, maxx, miny, maxy)")
        insert = "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        execute(f"{insert} VALUES (?, 'features', ?, ?, ?)", (table.name, _plain(title), table.about, _WGS84))
        # 2: some of the geometries have them
        dimensions = (2 * table.has_z, 2 * table.has_m)
        execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, ?, ?, ?, ?, ?)",
            (table.name, _GEOMETRY, table.geometry, _WGS84, *dimensions),
        )
        self._connection.executemany(
            "INSERT INTO gpkg_data_columns (table_name, column_name, description) VALUES (?, ?, ?)",
            ((table.name, field.name, field.about) for field in table.fields),
        )
        execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column,"
            " styleName, styleQML, styleSLD, useAsDefault, description, owner)"
            " VALUES ('', '', ?, ?, ?, ?, '', 1, '', '')",
            (table.name, _GEOMETRY, table.name, table.style),
        )

    def _keep_indexed(self, table: str) -> None:
        """Complete the spatial index of a table (extension `gpkg_rtree_index`) by its triggers, those of
        GeoPackage 1.4, in which mistakes of 1.3 are corrected."""
        index = _INDEX.format(t=table)
        for name, body in _TRIGGERS.items():
            self._connection.execute(
                f"CREATE TRIGGER {index}_{name} AFTER {body.format(t=table, i=index)} END"
            )
        self._connection.execute(
            "INSERT INTO gpkg_extensions VALUES (?, ?, 'gpkg_rtree_index', ?, 'write-only')",
            (table, _GEOMETRY, _INDEX_EXTENSION),
        )

    def _relate(self, table: str, mapping: str) -> None:
        """Create the tables for the pictures of a table's features."""
        if not self._media:
            self._connection.executescript(_MEDIA_SCHEMA)
            self._extend("gpkgext_relations", "gpkg_related_tables", _MEDIA_EXTENSION)
        self._connection.execute(
            f'CREATE TABLE "{mapping}" (base_id INTEGER NOT NULL, related_id INTEGER NOT NULL)'
        )
        self._connection.execute(
            "INSERT INTO gpkgext_relations (base_table_name, base_primary_column, related_table_name,"
            " related_primary_column, relation_name, mapping_table_name)"
            " VALUES (?, 'fid', 'pictures', 'id', 'media', ?)",
            (table, mapping),
        )
        self._extend(mapping, "gpkg_related_tables", _MEDIA_EXTENSION)

    def _extend(self, table: str, name: str, definition: str) -> None:
        insert = "INSERT INTO gpkg_extensions VALUES (?, NULL, ?, ?, 'read-write')"
        self._connection.execute(insert, (table, name, definition))


@contextmanager
def new_package(out: Path) -> Iterator[GeoPackage]:
    """Yield a GeoPackage that replaces a file once it is complete.

    Raises:
        UsageError: The name has another ending.
        StorageError: It cannot be written.
    """
    if out.suffix.lower() != ".gpkg":
        raise UsageError("unknown format", where=out.name, hint="the name of a GeoPackage ends in .gpkg")
    part = out.with_name(f".{secrets.token_hex(4)}{out.suffix}")
    try:
        with closing(sqlite3.connect(part)) as connection:
            yield GeoPackage(connection)
            connection.commit()
        part.replace(out)
    except OSError as error:
        raise storage_error(error, where=str(out)) from error
    except sqlite3.Error as error:
        raise UsageError(f"the file cannot be written: {error}", where=str(out)) from error
    finally:
        part.unlink(missing_ok=True)


def _plain(value: Any) -> Any:
    """Return a value as SQLite takes it: NaN is unknown, half a surrogate pair a question mark."""
    if isinstance(value, float) and math.isnan(value):
        return None
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value
