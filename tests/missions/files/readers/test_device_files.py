"""Files of devices and of maps: FIT, TCX, IGC, GeoJSON."""

import io
import json
import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers import fit, geojson_reader, igc, rtklib, tcx
from webapp.missions.files.readers.time_units import utc_from_gps
from webapp.missions.files.track_chunks import NO_TIME, UNTIMED, Findings, WorldObjects, WorldPiece
from webapp.missions.files.track_reader import kind_of

FIT_EPOCH = 631_065_600
SEMICIRCLES = 2**31 / 180.0


def read(reader: Callable[..., object], data: bytes | str) -> tuple[list[object], Findings]:
    findings = Findings()
    raw = data.encode() if isinstance(data, str) else data
    return list(reader(io.BytesIO(raw), findings=findings)), findings


def crc(data: bytes) -> int:
    """Compute the checksum of FIT: CRC-16 with the polynomial 0xA001."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (0xA001 if value & 1 else 0)
    return value


def fit_file(rows: list[tuple[int, float | None, float, float]]) -> bytes:
    """Return a FIT file of records (time, latitude, longitude, height)."""
    fields = [(253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (2, 2, 0x84)]
    body = bytes([0x40, 0, 0]) + struct.pack("<HB", 20, len(fields)) + b"".join(map(bytes, fields))
    for time_s, lat, lon, height in rows:
        place = (0x7FFFFFFF, 0x7FFFFFFF)
        if lat is not None:
            place = (round(lat * SEMICIRCLES), round(lon * SEMICIRCLES))
        body += b"\0" + struct.pack("<IiiH", time_s - FIT_EPOCH, *place, round((height + 500) * 5))
    head = struct.pack("<BBHI4s", 14, 0x20, 2132, len(body), b".FIT")
    head += struct.pack("<H", crc(head))
    return head + body + struct.pack("<H", crc(head + body))


def test_the_records_of_a_fit_are_a_track() -> None:
    data = fit_file(
        [
            (1_700_000_000, 50.5, -14.25, 200.4),
            (1_700_000_001, None, 0, 0),
            (1_700_000_002, 50.6, -14.25, 201),
        ]
    )
    assert fit.is_fit(data[:20])
    (piece,), findings = read(fit.read, data)
    assert isinstance(piece, WorldPiece)
    assert piece.poses.times_s.tolist() == [1_700_000_000.0, 1_700_000_002.0]
    assert piece.poses.latlon == pytest.approx(np.array([[50.5, -14.25], [50.6, -14.25]]), abs=1e-7)
    assert piece.poses.height_m == pytest.approx([200.4, 201.0])
    assert [one.reason for one in findings.skipped()] == ["records without a position"]
    for damaged in (data[:-20], data[:30] + b"\xff" + data[31:]):
        with pytest.raises(TrackError, match="the FIT file is damaged"):
            read(fit.read, damaged)


def test_each_file_of_a_chain_is_a_track() -> None:
    first, second = ([(1_700_000_000 + day, 50.0, 14.0, 200.0)] for day in (0, 86_400))
    pieces, _ = read(fit.read, fit_file(first) + fit_file(second))
    assert [(piece.track, piece.poses.times_s[0]) for piece in pieces] == [
        ("part 1", 1_700_000_000.0),
        ("part 2", 1_700_086_400.0),
    ]


def test_a_fit_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "MAX_BYTES", 50)
    with pytest.raises(TrackError, match="the FIT file is larger than"):
        read(fit.read, fit_file([(1_700_000_000, 50.5, -14.25, 200.4)] * 3))


TCX = """<TrainingCenterDatabase xmlns="http://www.garmin.com/xmlschemas/TrainingCenterDatabase/v2"><Activities>
<Activity Sport="Running"><Lap><Track>{points}</Track></Lap><Lap><Track>{more}</Track></Lap></Activity>
</Activities><Courses><Course><Name>loop</Name><Track>{course}</Track>
<CoursePoint><Name>Turn</Name><Position><LatitudeDegrees>50.2</LatitudeDegrees>
<LongitudeDegrees>14.2</LongitudeDegrees></Position><PointType>Left</PointType></CoursePoint>
</Course></Courses></TrainingCenterDatabase>"""


def trackpoint(lat: float | None, time: str = "") -> str:
    place = f"<LatitudeDegrees>{lat}</LatitudeDegrees><LongitudeDegrees>14</LongitudeDegrees>"
    place = f"<Position>{place}</Position>"
    when = f"<Time>{time}</Time>" if time else ""
    return f"<Trackpoint>{when}{place if lat else ''}<AltitudeMeters>7.5</AltitudeMeters></Trackpoint>"


def test_activities_and_courses_of_a_tcx_are_tracks() -> None:
    points = (
        trackpoint(50.0, "2024-03-23T12:00:00Z") + trackpoint(None, "2024-03-23T12:00:01Z") + trackpoint(50.1)
    )
    more = trackpoint(50.2, "2024-03-23T12:00:05.5Z")
    pieces, findings = read(tcx.read, TCX.format(points=points, more=more, course=trackpoint(51.0)))
    activity, point, course = pieces
    assert activity.track == "activity 1"
    assert activity.poses.latlon.tolist() == [[50.0, 14.0], [50.2, 14.0]]
    assert activity.poses.times_s.tolist() == [
        unix_time("2024-03-23T12:00:00Z"),
        unix_time("2024-03-23T12:00:05.5Z"),
    ]
    assert activity.poses.height_m.tolist() == [7.5, 7.5]
    assert (course.track, course.timed) == ("course 1", False)
    assert isinstance(point, WorldObjects)
    assert (point.sightings[0].kind, point.sightings[0].latlon) == ("Left", (50.2, 14.2))
    assert {one.reason for one in findings.skipped()} == {"points without a position", NO_TIME}


def test_course_points_of_the_same_name_are_numbered() -> None:
    course = TCX.format(points="", more="", course=trackpoint(51.0))
    point = course[course.index("<CoursePoint>") : course.index("</Course>")]
    pieces, _ = read(tcx.read, course.replace(point, point * 2))
    ids = [piece.sightings[0].object_id for piece in pieces if isinstance(piece, WorldObjects)]
    assert ids == ["waypoint 1 course 1 Turn", "waypoint 2 course 1 Turn"]


IGC = """AXXXABC
HFDTEDATE:160701,01
I033638LAD3941LOD4242TDS
C150701213841160701000102500KTri
B2359595107126N00149300WA00288004295001239
B0000015107126S00149300EV00288004290000000
B0000020000000N00000000EV0000000000000000
Bbroken
"""


def test_a_flight_goes_on_after_midnight() -> None:
    (piece,), findings = read(igc.read, IGC)
    assert igc.is_igc(IGC.splitlines())
    assert piece.poses.times_s.tolist() == [
        unix_time("2001-07-16T23:59:59Z") + 0.9,
        unix_time("2001-07-17T00:00:01Z"),
    ]
    assert piece.poses.latlon[0] == pytest.approx([51 + 7.1265 / 60, -(1 + 49.3001 / 60)], abs=2e-6)
    assert piece.poses.latlon[1] == pytest.approx([-(51 + 7.126 / 60), 1 + 49.3 / 60])
    assert piece.poses.height_m[0] == 429.0
    assert math.isnan(piece.poses.height_m[1]), "the receiver has no height"
    reasons = [one.reason for one in findings.skipped()]
    assert reasons == [
        "lines of a declared task, which is not a track",
        "fixes marked invalid by the receiver",
        "fixes that cannot be read",
    ]
    with pytest.raises(TrackError, match="before the date"):
        read(igc.read, "AXXX\nB2359595107126N00149300WA0028800429\n")


def collection(*features: dict[str, object]) -> str:
    return json.dumps({"type": "FeatureCollection", "features": list(features)})


def feature(kind: str, coordinates: object, **more: object) -> dict[str, object]:
    properties = more.pop("properties", {})
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties, **more}


def test_lines_with_and_without_times() -> None:
    times = ["2024-03-23T12:00:00Z", None, "2024-03-23T12:00:02Z"]
    line = [[14, 50, 200], [14.1, 50], [14.2, 50]]
    pieces, findings = read(
        geojson_reader.read,
        collection(
            feature("LineString", line, properties={"name": "walk", "coordTimes": times}),
            feature("MultiLineString", [line[:1], line[1:]]),
            feature("Polygon", [line]),
        ),
    )
    timed, untimed = pieces
    assert (timed.track, timed.timed) == ("line 1 walk", True)
    assert timed.poses.latlon.tolist() == [[50.0, 14.0], [50.0, 14.2]]
    assert timed.poses.times_s[1] - timed.poses.times_s[0] == 2.0
    assert timed.poses.height_m[0] == 200.0
    assert (len(untimed.poses), untimed.timed) == (3, False)
    assert findings.notes == [UNTIMED]
    assert [one.reason for one in findings.skipped()] == [NO_TIME, "areas, which are not tracks"]


def test_points_are_poses_where_they_have_times_and_objects_otherwise() -> None:
    pieces, _ = read(
        geojson_reader.read,
        collection(
            feature("Point", [14, 50], properties={"time": 1_700_000_000_000, "heading": 90}),
            feature("Point", [14, 50.1], properties={"time": 1_700_000_001}),
            feature("Point", [14, 50.2], properties={"name": "bin"}),
        ),
    )
    thing, track = pieces
    assert thing.sightings[0].object_id == "point 3 bin"
    assert track.poses.times_s.tolist() == [1_700_000_000.0, 1_700_000_001.0]
    assert track.poses.heading_deg[0] == 90.0


def test_every_point_has_an_id_of_its_own() -> None:
    places = [[14, 50], [14, 50.1]]
    collected = {"type": "GeometryCollection", "geometries": [{"type": "MultiPoint", "coordinates": places}]}
    pieces, _ = read(
        geojson_reader.read,
        collection(
            feature("MultiPoint", places, properties={"name": "bin"}),
            {"type": "Feature", "geometry": collected},
            feature("MultiPoint", places, id="lamp"),
        ),
    )
    ids = [piece.sightings[0].object_id for piece in pieces]
    assert ids == ["point 1 bin", "point 2 bin", "point 3", "point 4", "lamp", "lamp 2"]


def test_a_number_beyond_every_float_is_none() -> None:
    pieces, findings = read(geojson_reader.read, collection(feature("Point", [10**400, 50])))
    assert not pieces
    assert [one.reason for one in findings.skipped()] == ["points without a position"]


def test_a_geojson_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(geojson_reader, "MAX_BYTES", 50)
    with pytest.raises(TrackError, match="the GeoJSON is larger than"):
        read(geojson_reader.read, collection(feature("Point", [14, 50])))


@pytest.mark.parametrize("text", ["{", "[1, 2]", '{"a": 1}', '{"type": "Topology"}'])
def test_other_json_is_refused(text: str) -> None:
    with pytest.raises(TrackError, match="JSON"):
        read(geojson_reader.read, text)


@pytest.mark.parametrize(
    "geometry", [None, 7, {"type": "Point"}, {"type": "Point", "coordinates": "x"}, {"type": "LineString"}]
)
def test_odd_geometries_are_left_out(geometry: object) -> None:
    pieces, findings = read(geojson_reader.read, json.dumps({"type": "Feature", "geometry": geometry}))
    assert not pieces
    assert findings.skipped()


CRS = [
    {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}},
    {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG:6.9:25833"}},
    {"type": "name", "properties": {"name": "http://www.opengis.net/def/crs/EPSG/0/25833"}},
    {"type": "name", "properties": {"name": "EPSG:25833"}},
    {"type": "EPSG", "properties": {"code": 25833}},
]


@pytest.mark.parametrize("crs", CRS)
def test_a_geojson_in_another_coordinate_system_is_transformed(crs: object) -> None:
    line = {"type": "LineString", "coordinates": [[458000, 5550000, 200], [458010, 5550000]]}
    one = {"type": "Feature", "geometry": line, "properties": {}}
    collection = {"type": "FeatureCollection", "crs": crs, "features": [one]}
    for document in (collection, {**one, "crs": crs}, {**line, "crs": crs}):
        (piece,), findings = read(geojson_reader.read, json.dumps(document))
        assert piece.poses.latlon[0] == pytest.approx([50.100770, 14.412727], abs=1e-6)
        assert piece.poses.height_m[0] == 200.0
        assert findings.notes[0] == "positions were transformed from EPSG:25833, ETRS89 / UTM zone 33N"


def test_web_mercator_and_wgs84_by_name() -> None:
    for name, x, y in (("urn:ogc:def:crs:EPSG::3857", 1603000.67, 6463000.0), ("OGC:CRS84", 14.4, 50.1)):
        crs = {"type": "name", "properties": {"name": name}}
        text = json.dumps({"type": "LineString", "coordinates": [[x, y]], "crs": crs})
        (piece,), _ = read(geojson_reader.read, text)
        assert piece.poses.latlon[0] == pytest.approx([50.1, 14.4], abs=0.01)


@pytest.mark.parametrize(
    "crs",
    [
        *({"type": "name", "properties": {"name": name}} for name in ("CRS84", "crs84", "WGS84", "WGS 84")),
        {"type": "OGC", "properties": {"urn": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
        {"type": "name", "properties": {"name": "EPSG:4326"}},
        {"type": "EPSG", "properties": {"code": 4326}},
    ],
)
def test_other_names_of_wgs84_are_known(crs: dict[str, object]) -> None:
    text = json.dumps({"type": "LineString", "coordinates": [[14.4, 50.1]], "crs": crs})
    (piece,), findings = read(geojson_reader.read, text)
    assert piece.poses.latlon.tolist() == [[50.1, 14.4]]
    assert not any("transformed" in note for note in findings.notes)


@pytest.mark.parametrize(
    "crs",
    [
        {"type": "link", "properties": {"href": "http://example.com/crs/42", "type": "proj4"}},
        {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::999999"}},
        {"type": "name", "properties": {"name": "+proj=utm +zone=33 +nadgrids=/etc/passwd"}},
    ],
)
def test_an_unknown_coordinate_system_is_refused_by_name(crs: dict[str, dict[str, str]]) -> None:
    text = json.dumps({"type": "Point", "coordinates": [1, 2], "crs": crs})
    named = crs["properties"].get("name") or crs["properties"]["href"]
    with pytest.raises(TrackError, match="coordinate system") as error:
        read(geojson_reader.read, text)
    assert named in error.value.message


@pytest.mark.parametrize("kind", ["LineString", "MultiLineString", "Point", "MultiPoint"])
@pytest.mark.parametrize("crs", [{}, {"crs": None}])
def test_metres_without_a_coordinate_system_are_refused_in_a_sentence(
    kind: str, crs: dict[str, None]
) -> None:
    places = [[458000.5, 5550000], [458010, 5550010], [458020, 5550020]]
    nested = {"LineString": places, "MultiLineString": [places], "Point": places[0], "MultiPoint": places}
    text = json.dumps({**json.loads(collection(feature(kind, nested[kind]))), **crs})
    message = r"such as 458000.5, 5550000, are beyond degrees, and the file states no coordinate system"
    with pytest.raises(TrackError, match=message) as error:
        read(geojson_reader.read, text)
    assert error.value.hint == "export it in WGS 84 (EPSG:4326)"


def test_single_positions_beyond_degrees_do_not_refuse_a_file() -> None:
    (piece,), _ = read(
        geojson_reader.read, json.dumps(feature("LineString", [[14, 50], [1e9, 1e9], [14.1, 50]]))
    )
    assert len(piece.poses) == 3, "the import leaves out the wrong one, with a count"


def test_a_sequence_of_features_is_read_to_where_it_was_cut() -> None:
    features = [
        json.dumps(feature("Point", [14, 50 + n], properties={"time": f"2026-05-01T10:00:0{n}Z"}))
        for n in range(3)
    ]
    for text in ("\n".join(features), "".join(f"\x1e{one}\n" for one in features), " ".join(features)):
        (piece,), findings = read(geojson_reader.read, text)
        assert (len(piece.poses), piece.timed) == (3, True)
        assert not findings.skipped()
    (piece,), findings = read(geojson_reader.read, "\n".join(features)[:-5])
    assert len(piece.poses) == 2
    assert [one.reason for one in findings.skipped()] == ["features that are cut off"]


RTKLIB = """% program   : RTKPOST ver.2.4.3
%  {head}  Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio
{row}   1   9   0.0300   0.0200   0.0400  -0.0100   0.0020   0.0030   0.00  999.9
"""


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("GPST latitude(deg) longitude(deg) height(m)", "2026/05/01 10:00:18.500 -50.1 14.4 230.0"),
        ("UTC latitude(deg) longitude(deg) height(m)", "2026/05/01 10:00:00.500 -50.1 14.4 230.0"),
        ("JST latitude(deg) longitude(deg) height(m)", "2026/05/01 19:00:00.500 -50.1 14.4 230.0"),
        ("GPST latitude(deg) longitude(deg) height(m)", "2416 468018.500 -50.1 14.4 230.0"),
        (
            "GPST latitude(d'\") longitude(d'\") height(m)",
            "2026/05/01 10:00:18.500 -50 6 0.0 14 24 0.0 230.0",
        ),
    ],
)
def test_a_solution_of_rtklib(head: str, row: str) -> None:
    (piece,), _ = read(rtklib.read, RTKLIB.format(head=head, row=row))
    assert piece.poses.times_s.tolist() == [unix_time("2026-05-01T10:00:00.5Z")]
    assert [*piece.poses.latlon[0], piece.poses.height_m[0]] == pytest.approx([-50.1, 14.4, 230.0])
    assert piece.poses.covariance_m2[0].tolist() == pytest.approx([4e-4, 9e-4, -1e-4]), "to the east first"


def test_leap_seconds_are_those_of_the_day() -> None:
    for day, ahead in (("2026-05-01", 18), ("2016-12-31", 17), ("2010-01-01", 15), ("1999-06-01", 13)):
        assert utc_from_gps(unix_time(f"{day}T12:00:00Z") + ahead) == unix_time(f"{day}T12:00:00Z")


def test_a_solution_in_other_coordinates_or_with_bad_lines() -> None:
    with pytest.raises(TrackError, match="x-ecef, not latitude and longitude"):
        read(rtklib.read, RTKLIB.format(head="GPST x-ecef(m) y-ecef(m) z-ecef(m)", row="1 2 3 4 5"))
    head, row = "GPST latitude(deg) longitude(deg) height(m)", "2026/05/01 10:00:18 50 14 230"
    (piece,), findings = read(rtklib.read, RTKLIB.format(head=head, row=row) + "2026/05/01 10:00:19 5\n")
    assert len(piece.poses) == 1
    assert [one.reason for one in findings.skipped()] == ["lines that are no solution"]


def test_an_igc_without_its_first_record_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "flight"
    path.write_text("HFDTE010526\nHFPLTPILOT:x\nB1000005006000N01424000EA0020000230\n")
    assert kind_of(path).name == "igc"
