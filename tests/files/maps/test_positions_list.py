"""Positions of photos by file name."""

import json
import time

import pytest
from pyproj import Transformer

from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import CfgError, TableError, TrackError, UsageError
from webapp.files.maps.positions import read_positions


def listing(tmp_path, text, name="list.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_degrees(tmp_path):
    found = read_positions(listing(tmp_path, "name;lat;lon\na/1.jpg;50.5;14\nb\\2.jpg;-1;2\n"))
    assert found.by_name == {"a/1.jpg": LatLon(50.5, 14), "b/2.jpg": LatLon(-1, 2)}
    assert not found.in_pixels
    assert found.image_size is None


def test_pixels(tmp_path):
    found = read_positions(listing(tmp_path, "Name; X; Y\n1.jpg;10.5;20\n"))
    assert found.by_name == {"1.jpg": MapPixel(10.5, 20)}
    assert found.in_pixels


def test_a_map_file(tmp_path):
    found = read_positions(listing(tmp_path, "plan.png;100;80\n7;photos/1.jpg;10;20\n", "other.cfg"))
    assert found.by_name == {"photos/1.jpg": MapPixel(10, 20)}
    assert (found.in_pixels, found.image_size) == (True, (100, 80))


def test_names_are_found_by_path_or_by_an_only_file_name(tmp_path):
    found = read_positions(listing(tmp_path, "name;x;y\na/1.jpg;1;1\nb/1.jpg;2;2\nb/2.jpg;3;3\n4.jpg;4;4\n"))
    assert found.find("a/1.jpg") == (1, 1)
    assert found.find("c/2.jpg") == (3, 3)
    assert found.find("deep/down/4.jpg") == (4, 4)
    assert found.find("1.jpg") is None
    assert found.find("5.jpg") is None


def test_long_numbers_and_lists_are_refused_before_they_cost_time(tmp_path, monkeypatch):
    started = time.process_time()
    with pytest.raises(TableError, match="is not a number"):
        read_positions(listing(tmp_path, f"name;x;y\n1.jpg;{'1' * 800}a;1\n"))
    monkeypatch.setattr(json, "loads", None)
    with pytest.raises(TableError, match="more than 1000000 values"):
        read_positions(listing(tmp_path, '{"features":[' + "1," * 1_000_000 + "1]}"))
    assert time.process_time() - started < 5


def test_a_long_list_is_searched_once_for_all_photos(tmp_path):
    names = [f"a/{n}.jpg" for n in range(4000)]
    found = read_positions(listing(tmp_path, "name;x;y\n" + "".join(f"{name};1;2\n" for name in names)))
    started = time.process_time()
    assert all(found.find(name.replace("a/", "b/")) == (1, 2) for name in names)
    assert time.process_time() - started < 2


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("name;lon;when\n1.jpg;2;3\n", "no columns of names and positions"),
        ("1.jpg;2;3\n", "name=1, lat=2"),
        ("", "empty"),
        ("name;x;y\n1.jpg;a;2\n", ":2"),
        ("name;x;y\n1.jpg;1;2\n1.jpg;3;4\n", ":3"),
        ("name;lat;lon\n1.jpg;140;50\n", "swapped"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, part):
    with pytest.raises(TableError) as caught:
        read_positions(listing(tmp_path, text))
    assert part in str(caught.value)


def test_a_bad_map_file_is_refused(tmp_path):
    with pytest.raises(CfgError):
        read_positions(listing(tmp_path, "plan.png;100\n", "other.cfg"))


def test_headings_may_come_along(tmp_path):
    found = read_positions(
        listing(tmp_path, "name;x;y;heading_deg\na/1.jpg;1;1;90.5\n2.jpg;2;2;\n3.jpg;3;3;360\n")
    )
    assert [found.heading_of(name) for name in ("1.jpg", "2.jpg", "3.jpg", "4.jpg")] == [
        90.5,
        None,
        0.0,
        None,
    ]
    with pytest.raises(TableError, match="not from 0 to 360") as caught:
        read_positions(listing(tmp_path, "name;lat;lon;heading_deg\n1.jpg;1;1;361\n"))
    assert caught.value.where.endswith(":2")


@pytest.mark.parametrize(
    "text",
    [
        "SourceFile,GPSLatitude,GPSLongitude,GPSImgDirection\n"
        """./a/1.jpg,"50 deg 5' 0.60"" N","14 deg 25' 12.00"" W",90.5\n./a/2.jpg,,,\n""",
        "SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef,GPSImgDirection\n"
        "./a/1.jpg,50.0835,North,14.42,West,90.5\n2.jpg,-,-,-,-,-\n",
        "lat\tlon\theading\tfile name\n50.0835\t-14.42\t90.5\t./a/1.jpg\n",
        '"Latitude [deg]";"Longitude [deg]";Direction;"Image"\r\n"50,0835";"-14,42";"90,5";./a/1.jpg\r\n',
        "\ufeffphoto|LAT|LNG|heading_deg\n./a/1.jpg|N50°05.010'|-14.42|-269.5\n",
    ],
)
def test_tables_of_any_header_and_delimiter(tmp_path, text):
    found = read_positions(listing(tmp_path, text))
    assert list(found.by_name) == ["./a/1.jpg"]
    assert found.by_name["./a/1.jpg"] == pytest.approx((50.0835, -14.42))
    assert found.headings_deg == {"./a/1.jpg": 90.5}


def test_columns_are_named_where_the_header_is_strange_or_missing(tmp_path):
    strange = listing(tmp_path, "Breitengrad,Länge,was\n50.5,14.25,1.jpg\n")
    named = read_positions(strange, columns="lat=Breitengrad, lon=2, name=was")
    bare = listing(tmp_path, "1.jpg 10 20\n2.jpg 30.5 40\n", "list.txt")
    assert named.by_name == {"1.jpg": LatLon(50.5, 14.25)}
    assert read_positions(bare, columns="name=1, x=2, y=3").by_name == {
        "1.jpg": MapPixel(10, 20),
        "2.jpg": MapPixel(30.5, 40),
    }
    with pytest.raises(UsageError, match="no column holds a name"):
        read_positions(strange, columns="lat=1, lon=2")


def feature(name, *coordinates, kind="Point", **properties):
    geometry = {"type": kind, "coordinates": coordinates} if coordinates else None
    return {"type": "Feature", "geometry": geometry, "properties": {"Name": name, **properties}}


GEOJSON = {
    "type": "FeatureCollection",
    "features": [
        feature("a\\1.jpg", 14.25, 50.5, 200, heading_deg=90.5),
        feature("2.jpg"),
        feature("3", [1, 2], [3, 4], kind="LineString"),
        feature("twice", 1, 2),
        feature("twice", 1, 3),
    ],
}
KML = """<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Folder>
<Placemark><name>first</name><Style><IconStyle><heading>90.5</heading></IconStyle></Style>
<ExtendedData><Data name="photo"><value>a/1.jpg</value></Data></ExtendedData>
<Point><coordinates>14.25,50.5,200</coordinates></Point></Placemark>
<Placemark><name>3</name><LineString><coordinates>1,2 3,4</coordinates></LineString></Placemark>
<Placemark><name>twice</name><Point><coordinates>1,2</coordinates></Point></Placemark>
<Placemark><name>twice</name><Point><coordinates>1,3</coordinates></Point></Placemark>
</Folder></Document></kml>"""
GPX = """<?xml version="1.0"?><gpx version="1.0"><wpt lat="50.5" lon="14.25"><name>a/1.jpg</name>
<course>90.5</course></wpt><wpt lat="1" lon="1"/><wpt lat="1" lon="2"><name>twice</name></wpt>
<wpt lat="1" lon="3"><name>twice</name></wpt><trk><trkseg><trkpt lat="1" lon="1"/></trkseg></trk></gpx>"""


@pytest.mark.parametrize("text", [json.dumps(GEOJSON), KML, GPX], ids=["geojson", "kml", "gpx"])
def test_points_that_are_named_like_photos(tmp_path, text):
    found = read_positions(listing(tmp_path, text, "any.txt"))
    assert found.by_name == {"a/1.jpg": LatLon(50.5, 14.25)}
    assert found.headings_deg == {"a/1.jpg": 90.5}
    assert found.repeated == ("twice",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not JSON"),
        ('{"features": 5}', "must be a list"),
        ('{"features": []}', "no point in it has a name"),
        (json.dumps(GEOJSON).replace("50.5", "95.5"), "features"),
        (json.dumps(GEOJSON).replace("50.5", '"x"'), "must be a number"),
        ("<html></html>", "neither KML nor GPX"),
        ("<kml><Placemark>", "damaged"),
        (GPX.replace('"50.5"', '"x"'), "waypoint 1"),
        (KML.replace("14.25,50.5", "14.25,95"), "placemark 1"),
        ('<!DOCTYPE gpx [<!ENTITY a "b">]><gpx/>', "entities"),
    ],
)
def test_damaged_lists_are_refused(tmp_path, text, says):
    with pytest.raises((TableError, TrackError)) as caught:
        read_positions(listing(tmp_path, text, "any.txt"))
    assert says in str(caught.value)


@pytest.mark.parametrize("code", ["urn:ogc:def:crs:EPSG::32633", "EPSG:3857", "EPSG:5514"])
def test_a_geojson_of_photos_in_another_coordinate_system_is_transformed_or_refused(tmp_path, code):
    epsg = int(code.rpartition(":")[2])
    xy = Transformer.from_crs(4326, epsg, always_xy=True).transform(14.4, 50.1)
    point = {
        "type": "Feature",
        "properties": {"photo": "a.jpg"},
        "geometry": {"type": "Point", "coordinates": xy},
    }
    whole = {"type": "FeatureCollection", "features": [point]}
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({**whole, "crs": {"type": "name", "properties": {"name": code}}}))
    assert tuple(read_positions(path).by_name["a.jpg"]) == pytest.approx((50.1, 14.4), abs=1e-7)
    path.write_text(json.dumps(whole))
    with pytest.raises(TableError, match="beyond degrees, and the file states no coordinate system"):
        read_positions(path)
    path.write_text(json.dumps({**whole, "crs": {"type": "name", "properties": {"name": "EPSG:999999"}}}))
    with pytest.raises(TableError, match="coordinate system 'EPSG:999999' is not known"):
        read_positions(path)
