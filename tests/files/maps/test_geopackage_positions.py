"""Positions from a GeoPackage, as QField and QGIS leave them; and files that were made to do harm."""

import sqlite3
import struct
from contextlib import closing
from functools import partial

import pytest

from tests.geopackages import POINTS, point, write_package
from webapp.core.geo.types import LatLon
from webapp.errors import TableError, TrackError
from webapp.files.maps import geopackage
from webapp.files.maps.positions import read_positions


def several(*points):
    """Encode points as one geometry."""
    parts = b"".join(point(*at)[8:] for at in points)
    return point(0, 0)[:8] + struct.pack("<BII", 1, 4, len(points)) + parts


@pytest.fixture
def package(tmp_path):
    """Writes a GeoPackage with one layer, and returns its path."""
    return partial(write_package, tmp_path / "points.gpkg")


GATE = (point(14.5, 50.25), "Gate", "DCIM/points_1.jpg", 90.0, "New\nhinge\x07")
POND = (point(14.6, 50.26, big=True, z=210.0, envelope=1), "Pond", "DCIM/points_2.JPG", None, None)
INDEX = """
CREATE VIRTUAL TABLE rtree_points_geom USING rtree(id, minx, maxx, miny, maxy);
CREATE TRIGGER rtree_points_geom_insert AFTER INSERT ON points WHEN new.geom NOT NULL
  BEGIN INSERT OR REPLACE INTO rtree_points_geom VALUES (NEW.fid, 0, 0, 0, 0); END;
CREATE VIEW seen AS SELECT * FROM points;
PRAGMA journal_mode = WAL;
"""


def test_photos_of_qfield_with_headings_and_notes(package):
    found = read_positions(package([GATE, POND], more=INDEX))
    assert found.by_name == {
        "DCIM/points_1.jpg": LatLon(50.25, 14.5),
        "DCIM/points_2.JPG": LatLon(50.26, 14.6),
    }
    assert found.headings_deg == {"DCIM/points_1.jpg": 90.0}
    assert found.notes == {"DCIM/points_1.jpg": "New\nhinge"}
    assert found.note_of("points_1.jpg") == "New\nhinge"


def test_points_without_a_photo_and_other_geometries_are_left_out(package):
    line = point(0, 0)[:8] + struct.pack("<BII4d", 1, 2, 2, 1, 2, 3, 4)
    rows = [
        GATE, (point(1, 2), "Tree", None, None, None), (None, "x", "b.jpg", None, None),
        (line, "x", "c.jpg", None, None), (point(float("nan"), float("nan")), "x", "d.jpg", None, None),
        (b"GP\0\x01\0", "x", "e.jpg", None, None), (several((14, 50)), "x", "f.jpg", None, None),
        (several((14, 50), (15, 50)), "x", "g.jpg", None, None),
    ]  # fmt: skip
    assert list(read_positions(package(rows)).by_name) == ["DCIM/points_1.jpg", "f.jpg"]


def test_a_column_with_a_usual_header_serves_where_no_name_has_a_suffix(package):
    found = read_positions(package([(point(14, 50), "IMG_1", "", None, None)]))
    assert list(found.by_name) == ["IMG_1"]


def test_photos_that_are_listed_twice_are_named(package):
    assert read_positions(package([GATE, GATE, POND])).repeated == ("DCIM/points_1.jpg",)


@pytest.mark.parametrize("srs", [32633, 100000])
def test_other_coordinate_systems_are_transformed(package, srs):
    rows = [(point(500000.0, 5538630.7), "Gate", "a.jpg", None, None)]
    (at,) = read_positions(package(rows, srs=srs)).by_name.values()
    assert at == pytest.approx((50.0, 15.0), abs=1e-6)


@pytest.mark.parametrize(
    ("rows", "options", "says"),
    [
        ([GATE], {"srs": 100001}, "coordinate system 'nonsense' is not known"),
        ([(point(500000, 5500000), "", "a.jpg", None, None)], {}, "beyond degrees"),
        ([(point(14, 95), "", "a.jpg", None, None)], {}, "latitude"),
        ([(point(14, 50), "", "a.jpg", 1000.0, None)], {}, "heading"),
        ([], {}, "no point in it has a name"),
        ([GATE], {"more": "DROP TABLE gpkg_geometry_columns"}, "no GeoPackage"),
        (
            [GATE],
            {"columns": f"{POINTS}, more AS (zeroblob(1000000000))"},
            "a computed column",
        ),
        (
            [GATE],
            {"more": "DROP TABLE gpkg_contents; CREATE VIEW gpkg_contents AS SELECT 'points' AS table_name,"
             " 'features' AS data_type"},
            "no GeoPackage",
        ),
        (
            [GATE],
            {"more": "DROP TABLE points; CREATE VIEW points AS WITH RECURSIVE n(fid) AS (SELECT 1 UNION ALL"
             " SELECT fid + 1 FROM n) SELECT fid, x'00' AS geom, 'a.jpg' AS photo FROM n"},
            "no point in it has a name",
        ),
        ([GATE], {"more": "UPDATE points SET comment = printf('%.*c', 2000000, 'x')"}, "too big"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused(package, rows, options, says):
    with pytest.raises((TableError, TrackError), match=says) as refused:
        read_positions(package(rows, **options))
    assert "points.gpkg" in refused.value.where


def test_a_picture_in_the_table_is_not_read(package):
    path = package([GATE], more="UPDATE points SET data = zeroblob(50000000)")
    assert len(read_positions(path).by_name) == 1


def test_names_of_tables_and_columns_are_quoted(package):
    odd = "ALTER TABLE points RENAME COLUMN photo TO 'pho\"to'; ALTER TABLE points RENAME TO 'a\"b';"
    path = package([GATE], more=f"{odd} UPDATE gpkg_contents SET table_name = 'a\"b';"
                   " UPDATE gpkg_geometry_columns SET table_name = 'a\"b';")  # fmt: skip
    assert list(read_positions(path).by_name) == ["DCIM/points_1.jpg"]


def test_a_damaged_file_is_refused(package):
    path = package([GATE, POND] * 500)
    data = bytearray(path.read_bytes())
    data[100:9000] = b"\xff" * 8900
    path.write_bytes(data)
    with pytest.raises(TableError, match="cannot be read"):
        read_positions(path)


def test_changes_beside_the_file_are_not_overlooked(package):
    path = package([GATE])
    path.with_name("points.gpkg-wal").write_bytes(b"x")
    with pytest.raises(TableError, match="not in the file yet"):
        read_positions(path)


def test_the_number_of_points_is_limited(package, monkeypatch):
    path = package([GATE, POND])
    monkeypatch.setattr(geopackage, "_MOST_ROWS", 1)
    with pytest.raises(TableError, match="more than 1 points"):
        list(geopackage.rows(str(path), [".jpg"]))


def test_nothing_but_reading_is_allowed(package):
    with closing(sqlite3.connect(package([GATE]))) as connection:
        geopackage._guard(connection)
        for statement in (
            "DELETE FROM points",
            "SELECT zeroblob(9)",
            "ATTACH ':memory:' AS a",
            "PRAGMA user_version",
        ):
            with pytest.raises(sqlite3.DatabaseError, match=r"not authorized|prohibited"):
                connection.execute(statement)
