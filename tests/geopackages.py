"""GeoPackages with a layer of points that name photos, as QField writes them, by the specification alone."""

import sqlite3
import struct
from contextlib import closing

META = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT, srs_id INTEGER PRIMARY KEY, organization TEXT,
  organization_coordsys_id INTEGER, definition TEXT);
INSERT INTO gpkg_spatial_ref_sys VALUES ('WGS 84', 4326, 'EPSG', 4326, ''),
  ('UTM 33N', 32633, 'EPSG', 32633, ''), ('mine', 100000, 'nobody', 1, '+proj=utm +zone=33 +datum=WGS84'),
  ('none', 100001, 'nobody', 2, 'nonsense');
CREATE TABLE gpkg_contents (table_name TEXT, data_type TEXT);
CREATE TABLE gpkg_geometry_columns (table_name TEXT, column_name TEXT, srs_id INTEGER);
"""
POINTS = "fid INTEGER PRIMARY KEY, geom POINT, name TEXT, photo TEXT, heading REAL, comment TEXT, data BLOB"


def point(x, y, *, big=False, z=None, envelope=0):
    """Encode a point as the specification says: header, envelope, ISO WKB."""
    order, flags = (">", 0) if big else ("<", 1)
    box = struct.pack(f"{order}4d", x, x, y, y) if envelope else b""
    values = (x, y) if z is None else (x, y, z)
    head = b"GP\0" + bytes([flags | envelope << 1]) + struct.pack(f"{order}i", 4326)
    kind = 1 if z is None else 1001
    return head + box + bytes([not big]) + struct.pack(f"{order}I{len(values)}d", kind, *values)


def write_package(path, rows=(), *, columns=POINTS, srs=4326, more=""):
    """Write rows of geometry, name, photo, heading and comment as the layer `points`."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript(META)
        database.execute(f"CREATE TABLE points ({columns})")
        database.execute("INSERT INTO gpkg_contents VALUES ('points', 'features')")
        database.execute("INSERT INTO gpkg_geometry_columns VALUES ('points', 'geom', ?)", (srs,))
        insert = "INSERT INTO points (geom, name, photo, heading, comment) VALUES (?, ?, ?, ?, ?)"
        database.executemany(insert, rows)
        database.commit()
        database.executescript(more)
    return path
