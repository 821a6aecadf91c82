"""Maps and missions as GeoPackage: what GDAL reads, and what the specification demands."""

import io
import json
import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tests.connect.gis.ogr import read_layers, read_within
from webapp.app import main as program
from webapp.connect.gis.geopackage import new_package, point
from webapp.connect.gis.layers import add_mission
from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import make_poses
from webapp.progress import Progress

GEOREFERENCE = {
    "plane": "EPSG:4326",
    "plane_from_pixel": [[1e-5, 0.0, 14.0], [0.0, -1e-5, 50.0], [0.0, 0.0, 1.0]],
    "method": "corners",
}
EXPERIENCES = [
    {"id": 0, "photo": "photos/gate & <1>.jpg", "x_px": 20.25, "y_px": 19.5, "heading_deg": 271.5,
     "gps_accuracy_m": 4.0, "by_gps": True, "taken_at": "2026-04-30T14:05:00+02:00",
     "note": "The gate\nwas blue.", "floor": 1,
     "blurred": [{"x": 0.0, "y": 0.0, "width": 1.0, "height": 1.0}]},
    {"id": 3, "photo": "photos/pond.jpg", "x_px": 50.0, "y_px": 131.0, "radius_px": 10.0},
]  # fmt: skip
NOTES = [{"id": 1, "title": "Bench", "x_px": 100.0, "y_px": 50.0, "text": "New.", "photos": [0, 3]}]
FLOORS = [
    {"id": 0, "name": "Ground", "level": 0},
    {"id": 1, "name": "Upper", "level": 1, "height_m": 4.5, "image": {
        "path": "up.png", "width": 100, "height": 80, "map_from_image": [[0.5, 0, 10], [0, 0.5, 20]]}},
]  # fmt: skip


@pytest.fixture
def expmap(capsys):
    """Runs a command and returns exit code, standard output and standard error."""

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            program.main([str(word) for word in words])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


@pytest.fixture
def park(tmp_path):
    """A map of 200 x 160 pixels with two photos, a note and two floors; one photo is blurred as a whole."""
    folder = tmp_path / "maps" / "park"
    (folder / "photos").mkdir(parents=True)
    for name, size in (("plan.png", (200, 160)), ("up.png", (100, 80))):
        Image.new("RGB", size, (40, 160, 60)).save(folder / name)
    noise = np.random.default_rng(1).integers(0, 255, (60, 80, 3), np.uint8)
    for name in ("gate & <1>.jpg", "pond.jpg"):
        Image.fromarray(noise).save(folder / "photos" / name)
    lines = "0;photos/gate & <1>.jpg;20;20\n3;photos/pond.jpg;50;131\n"
    (folder / "map.cfg").write_text(f"plan.png;200;160\n{lines}")
    about = {"format": "experience-map", "version": 1, "title": "Park", "georeference": GEOREFERENCE}
    about |= {"experiences": EXPERIENCES, "notes": NOTES, "floors": FLOORS}
    (folder / "map.json").write_text(json.dumps(about))
    return folder / "map.cfg"


def rows(path, query):
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def numbers(wkt):
    """Return the kind of a geometry in WKT, and its coordinates."""
    kind, _, rest = wkt.partition("(")
    points = rest.replace("(", " ").replace(")", " ").split(",")
    return kind.strip(), [[float(number) for number in point.split()] for point in points]


def test_gdal_reads_the_layers_of_a_map(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    assert expmap("connect", "gis", "export", park, out) == (0, f"wrote {out}: 2 photos\n", "")
    layers = read_layers(out)
    gate, pond = layers["photos"]
    kind, ((lon, lat),) = numbers(gate.pop("geometry"))
    assert (kind, lon, lat) == ("POINT", pytest.approx(14.0002025), pytest.approx(49.999805))
    assert gate == {
        "id": "0", "photo": "maps/park/photos/gate & <1>.jpg", "name": "gate & <1>.jpg",
        "heading_deg": "271.5", "fov_deg": None, "radius_m": "4", "taken_at": "2026-04-30T14:05:00+02:00",
        "time": "2026/04/30 12:05:00+00", "floor": "Upper", "level": "1", "x_px": "20.25", "y_px": "19.5",
        "credit": None, "note": "The gate\nwas blue.",
    }  # fmt: skip
    metres = 10 * math.sqrt(1e-5 * 111_229 * 1e-5 * 111_320 * math.cos(math.radians(50)))
    assert float(pond["radius_m"]) == pytest.approx(metres, rel=0.01)
    assert (pond["heading_deg"], pond["time"], pond["note"]) == (None, None, None)
    (note,) = layers["notes"]
    assert (note["title"], note["note"], note["photos"]) == ("Bench", "New.", "0,3")
    ground, upper = layers["floors"]
    kind, corners = numbers(upper["geometry"])
    assert (kind, upper["name"], upper["height_m"]) == ("POLYGON", "Upper", "4.5")
    wanted = [
        (14.0001, 49.9998),
        (14.0001, 49.9994),
        (14.0006, 49.9994),
        (14.0006, 49.9998),
        (14.0001, 49.9998),
    ]
    np.testing.assert_allclose(corners, wanted, atol=1e-9)
    assert ground["level"] == "0"


def test_a_package_has_what_the_specification_demands(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    expmap("connect", "gis", "export", park, out)
    assert rows(out, "PRAGMA application_id") == [(0x47504B47,)]
    assert rows(out, "PRAGMA user_version") == [(10300,)]
    assert rows(out, "PRAGMA integrity_check") == [("ok",)]
    assert rows(out, "PRAGMA foreign_key_check") == []
    systems = rows(out, "SELECT srs_id, organization FROM gpkg_spatial_ref_sys ORDER BY srs_id")
    assert systems == [(-1, "NONE"), (0, "NONE"), (4326, "EPSG")]
    contents = rows(
        out,
        "SELECT table_name, data_type, identifier, srs_id, min_x, min_y, max_x, max_y FROM gpkg_contents"
        " WHERE table_name = 'photos'",
    )
    (name, kind, title, system, *bounds) = contents[0]
    assert (name, kind, title, system) == ("photos", "features", "Park: photos", 4326)
    assert bounds == pytest.approx([14.0002025, 49.99869, 14.0005, 49.999805])
    geometries = "SELECT table_name, geometry_type_name, srs_id, z, m FROM gpkg_geometry_columns ORDER BY 1"
    assert rows(out, geometries) == [
        ("floors", "POLYGON", 4326, 0, 0), ("notes", "POINT", 4326, 0, 0), ("photos", "POINT", 4326, 0, 0),
    ]  # fmt: skip
    # the header: magic, version, flags (little-endian, envelope of x and y), coordinate system
    ((outline,),) = rows(out, "SELECT geom FROM floors WHERE id = 1")
    assert outline[:8] == b"GP\0\x03" + (4326).to_bytes(4, "little")
    assert np.frombuffer(outline[8:40]) == pytest.approx([14.0001, 14.0006, 49.9994, 49.9998])
    described = rows(out, "SELECT count(*) FROM gpkg_data_columns WHERE description = ''")
    assert described == [(0,)]


AROUND_THE_GATE = (14.0001, 49.9997, 14.0003, 49.9999)


def test_gdal_finds_an_area_by_the_spatial_index(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    expmap("connect", "gis", "export", park, out)
    found, is_fast = read_within(out, "photos", AROUND_THE_GATE)
    assert ([one["id"] for one in found], is_fast) == (["0"], True)
    extensions = rows(out, "SELECT * FROM gpkg_extensions WHERE extension_name = 'gpkg_rtree_index'")
    assert {(table, column, scope) for table, column, _, _, scope in extensions} == {
        (table, "geom", "write-only") for table in ("photos", "notes", "floors")
    }
    ((west, east),) = rows(out, "SELECT minx, maxx FROM rtree_floors_geom WHERE id = 2")
    assert (west, east) == pytest.approx((14.0001, 14.0006), abs=2e-6)
    with closing(sqlite3.connect(out)) as database:
        database.execute("DELETE FROM rtree_photos_geom")
        database.commit()
    assert read_within(out, "photos", AROUND_THE_GATE)[0] == [], "it reads the index, not all features"


def test_the_spatial_index_follows_changes_of_other_programs(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    expmap("connect", "gis", "export", park, out)
    moved = point(LatLon(51.0, 15.0)).data
    with closing(sqlite3.connect(out)) as database:
        for name, at in (("ST_MinX", 0), ("ST_MaxX", 0), ("ST_MinY", 1), ("ST_MaxY", 1)):
            database.create_function(name, 1, lambda geometry, at=at: np.frombuffer(geometry[-16:])[at])
        database.create_function("ST_IsEmpty", 1, lambda geometry: False)

        def indexed():
            found = database.execute("SELECT id, round(minx, 3), round(maxy, 3) FROM rtree_photos_geom")
            return sorted(found.fetchall())

        gate, pond = (1, 14.0, 50.0), (2, 14.0, 49.999)
        assert indexed() == [gate, pond]
        change = database.execute
        change("INSERT INTO photos (geom) VALUES (?)", (moved,))
        change("UPDATE photos SET geom = NULL WHERE fid = 1")
        assert indexed() == [pond, (3, 15.0, 51.0)]
        change("UPDATE photos SET geom = ? WHERE fid IN (1, 2)", (moved,))
        assert indexed() == [(1, 15.0, 51.0), (2, 15.0, 51.0), (3, 15.0, 51.0)]
        change("UPDATE photos SET fid = 9 WHERE fid = 2")
        change("UPDATE photos SET fid = 8, geom = NULL WHERE fid = 1")
        change("DELETE FROM photos WHERE fid = 3")
        assert indexed() == [(9, 15.0, 51.0)]


def test_each_layer_has_a_default_style(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    expmap("connect", "gis", "export", park, out)
    styles = dict(rows(out, "SELECT f_table_name, styleQML FROM layer_styles WHERE useAsDefault"))
    assert set(styles) == {"photos", "notes", "floors"}
    tree = ElementTree.fromstring(styles["photos"])
    bound = tree.find(".//Option[@name='properties']/Option[@name='angle']/Option[@name='expression']")
    assert bound.get("value") == '"heading_deg"'
    assert tree.find(".//editWidget").get("type") == "ExternalResource"


def test_pictures_are_attached_blurred_and_without_metadata(park, tmp_path, expmap):
    out = tmp_path / "park.gpkg"
    assert expmap("connect", "gis", "export", "--attach", park, out)[0] == 0
    joined = rows(
        out,
        "SELECT f.id, p.content_type, p.data FROM photos f JOIN photos_pictures m ON m.base_id = f.fid"
        " JOIN pictures p ON p.id = m.related_id ORDER BY f.id",
    )
    assert [(id, kind) for id, kind, _ in joined] == [(0, "image/jpeg"), (3, "image/jpeg")]
    blurred, plain = (np.asarray(Image.open(io.BytesIO(data)), float) for _, _, data in joined)
    assert blurred.std() < 0.3 * plain.std()
    (relation,) = rows(
        out, "SELECT base_table_name, base_primary_column, relation_name FROM gpkgext_relations"
    )
    assert relation == ("photos", "fid", "media")
    extensions = rows(
        out, "SELECT table_name FROM gpkg_extensions WHERE extension_name = 'gpkg_related_tables'"
    )
    assert sorted(extensions) == [("gpkgext_relations",), ("photos_pictures",)]
    assert len(read_layers(out)["photos"]) == 2


def test_an_export_needs_a_georeference_and_leaves_an_older_file_alone(park, tmp_path, expmap):
    (park.parent / "map.json").unlink()
    out = tmp_path / "park.gpkg"
    out.write_bytes(b"before")
    code, _, error = expmap("connect", "gis", "export", park, out)
    assert code == 2
    assert "no georeference" in error
    assert out.read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".gpkg"] == ["park.gpkg"]
    assert expmap("connect", "gis", "export", park, tmp_path / "park.zip")[0] == 2


def track(id, latlon, *, height_m=None, timed=True, **more):
    latlon = np.asarray(latlon, float)
    times = 1714557600.25 + np.arange(len(latlon))
    poses = make_poses(times, latlon, height_m=height_m, **more)
    west, east = latlon[:, 1].min(), latlon[:, 1].max()
    bounds = (latlon[:, 0].min(), west, latlon[:, 0].max(), east)
    parts = [poses.take(slice(0, 2)), poses.take(slice(2, None))]
    return ExportTrack(id, "gps", "Rex", len(latlon), 9.5, bounds, lambda: iter(parts), timed=timed)


def written(tmp_path, tracks, objects=()):
    mission = MissionExport("Search", tuple(tracks), (), lambda: objects)
    with new_package(tmp_path / "search.gpkg") as package:
        add_mission(package, mission, progress=Progress())
    return read_layers(tmp_path / "search.gpkg")


def test_gdal_reads_the_layers_of_a_mission(tmp_path):
    covariance = [(4.0, 4.0, 0.0), (np.nan,) * 3, (1.0, 1.0, 0.0)]
    going = track(
        7, [(50, 14), (50.1, 14), (50.2, 14.1)], height_m=[1, 2, 3.5], heading_deg=[0, np.nan, 90],
        covariance_m2=covariance,
    )  # fmt: skip
    seen = ExportObject(
        "a", "victim", LatLon(50, 14), 1714557600.0, 1714557601.5, None, 0.8, 3, "ab" * 32, (1, 1, 0),
        (0.5, 0.4, 1.7), "confirmed",
    )  # fmt: skip
    layers = written(tmp_path, [going], [seen])
    (line,) = layers["tracks"]
    kind, points = numbers(line["geometry"])
    assert kind == "MULTILINESTRING ZM"
    assert points == [
        [14, 50, 1, 1714557600.25], [14, 50.1, 2, 1714557601.25], [14.1, 50.2, 3.5, 1714557602.25],
    ]  # fmt: skip
    assert (line["track"], line["first_time"]) == ("7", "2024/05/01 10:00:00.250+00")
    first, second, _ = layers["poses"]
    assert first["geometry"] == "POINT Z (14 50 1)"
    assert (first["time"], first["radius_m"]) == ("2024/05/01 10:00:00.250+00", "3.03")
    assert (second["heading_deg"], second["radius_m"]) == (None, None)
    (victim,) = layers["objects"]
    assert (victim["id"], victim["class"], victim["state"], victim["size_z_m"]) == (
        "a",
        "victim",
        "confirmed",
        "1.7",
    )
    assert victim["geometry"] == "POINT (14 50)"


def test_tracks_look_as_people_have_set_it(tmp_path):
    look = TrackLook("Team <2>", "#12ab34", 6.0, hidden=True)
    going = replace(track(7, [(50, 14), (50.1, 14)]), look=look)
    first, second = written(tmp_path, [going, track(8, [(50, 14), (50.1, 14)])])["tracks"]
    names = ("name", "stroke", "stroke_width", "hidden")
    assert [first[name] for name in names] == ["Team <2>", "#12ab34", "6", "1"]
    assert [second[name] for name in names] == ["Rex", "#0072b2", "3.5", "0"]
    wanted = "SELECT styleQML FROM layer_styles WHERE f_table_name = 'tracks'"
    ((style,),) = rows(tmp_path / "search.gpkg", wanted)
    tree = ElementTree.fromstring(style)
    about = [[c.get(name) for name in ("value", "type", "label", "render")] for c in tree.iter("category")]
    assert about == [["7", "long", "Team <2>", "false"], ["8", "long", "gps: Rex", "true"]]
    colours = [o.get("value") for o in tree.iter("Option") if o.get("name") == "line_color"]
    assert colours == ["18,171,52,255", "0,114,178,255"]


def test_a_track_over_the_180th_meridian_is_cut_there(tmp_path):
    layers = written(tmp_path, [track(1, [(0, 179), (0, -179), (0, -178)])])
    kind, points = numbers(layers["tracks"][0]["geometry"])
    assert kind == "MULTILINESTRING M"  # the heights are unknown
    assert [point[0] for point in points] == [179, 180, -180, -179, -178]


def test_times_that_only_order_poses_are_left_out_and_one_pose_is_no_line(tmp_path):
    layers = written(tmp_path, [track(1, [(0, 1), (0, 2)], timed=False), track(2, [(0, 3)])])
    untimed, single = layers["tracks"]
    assert (untimed["geometry"], untimed["first_time"]) == ("MULTILINESTRING ((1 0,2 0))", None)
    assert (single["geometry"], single["last_time"]) == (None, "2024/05/01 10:00:00.250+00")
    assert [pose["time"] is None for pose in layers["poses"]] == [True, True, False]


def test_a_mission_of_the_library_is_exported(tmp_path, expmap):
    library = ("--library", tmp_path / "library")
    gpx = tmp_path / "rex.gpx"
    points = "".join(
        f'<trkpt lat="{50 + n / 1e4}" lon="14.0"><time>2024-05-01T10:00:0{n}Z</time></trkpt>'
        for n in range(5)
    )
    gpx.write_text(
        f'<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" creator="t"><trk><name>Rex</name>'
        f"<trkseg>{points}</trkseg></trk></gpx>"
    )
    expmap("mission", "new", "Search", *library)
    assert expmap("mission", "import", "1", gpx, *library)[0] == 0
    out = tmp_path / "search.gpkg"
    code, said, _ = expmap("connect", "gis", "export-mission", "1", out, "--points", "3", *library)
    assert (code, said) == (0, f"wrote {out}: 1 tracks, 3 poses, 0 objects\n")
    assert len(read_layers(out)["poses"]) == 3


def test_names_that_are_no_unicode_are_written(tmp_path):
    with new_package(tmp_path / "odd.gpkg") as package:
        add_mission(package, MissionExport("a\udcff", (), (), list), progress=Progress())
    assert rows(tmp_path / "odd.gpkg", "SELECT count(*) FROM tracks") == [(0,)]


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(UsageError, match="unknown format"), new_package(tmp_path / "search.db"):
        pass
