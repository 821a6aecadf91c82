"""Files of every kind become tracks and objects on the Earth."""

import itertools
import math
import time
from pathlib import Path

import numpy as np
import pytest
from pyproj import Geod
from rosbags.highlevel import AnyReader

from webapp.core.geo.types import LatLon
from webapp.errors import Cancelled, TrackError
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.tasks import read_track
from webapp.missions.tasks.place_track import NO_START, ReadOptions
from webapp.progress import Progress

ALL = MinMove(0.0)
EAST = Start(LatLon(50.0, 14.0), 90.0)

TEXTS = {
    "GPX": '<gpx><trk><trkseg><trkpt lat="50" lon="14"/></trkseg></trk></gpx>',
    "KML": "<kml><Placemark><LineString><coordinates>14,50</coordinates></LineString></Placemark></kml>",
    "NMEA 0183": "$GPGLL,5000.000,N,01400.000,E,120000,A\n",
    "TUM trajectory": "1.0 0 0 0 0 0 0 1\n",
    "KITTI trajectory": "1 0 0 0 0 1 0 0 0 0 1 0\n",
    "table": "time,lat,lon\n1,50,14\n",
    "GeoJSON": '{"type": "LineString", "coordinates": [[14, 50]]}',
    "IGC": "AXXX\nHFDTE010120\nB1200005000000N01400000EA0020000200\n",
    "RTKLIB solution": "% UTC latitude(deg) longitude(deg) height(m) Q\n2026/05/01 10:00:00 50 14 200 1\n",
    "TCX": "<TrainingCenterDatabase><Course><Trackpoint><Position><LatitudeDegrees>50</LatitudeDegrees>"
    "<LongitudeDegrees>14</LongitudeDegrees></Position></Trackpoint></Course></TrainingCenterDatabase>",
}


def on(folder: Path, text: str, name: str = "upload") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", TEXTS)
def test_the_kind_is_detected_from_the_content(tmp_path, kind) -> None:
    report = read_track.read_track(on(tmp_path, TEXTS[kind], "wrong.bag"), options=ReadOptions(start=EAST))
    assert report.kind == kind
    assert report.tracks[0].poses.latlon[0] == pytest.approx([50.0, 14.0])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "not a file with a track"),
        (b"<svg/>", "neither GPX, TCX nor KML"),
        (b"hello\nworld\n", "no known format"),
        (b"PK\x03\x04broken", "zip is damaged"),
        (b"#ROSBAG V1.2\nold", "version 102 is not supported"),
        (b"a,b\n1,2\n", "no columns of positions"),
        (b"<kml/>", "nothing in it can be used: it has no track and no object"),
        ("lat,lon\n50,14".encode("utf-16"), "UTF-16 text"),
        (b"AXXX\nHFDTE010100\n", "no track and no object"),
        (b"lat,lon\n91,14\n", r"positions with an invalid latitude or longitude \(1\)"),
    ],
)
def test_unusable_files_are_refused_in_a_sentence(tmp_path, data, message) -> None:
    path = tmp_path / "upload.gpx"
    path.write_bytes(data)
    with pytest.raises(TrackError, match=message) as error:
        read_track.read_track(path)
    assert error.value.where == "upload.gpx"


def test_poses_of_the_robot_need_a_start(tmp_path) -> None:
    with pytest.raises(TrackError, match=NO_START):
        read_track.read_track(on(tmp_path, TEXTS["TUM trajectory"]))


def test_the_way_is_measured_before_thinning(tmp_path) -> None:
    jitter = "".join(f"{i} {(i % 2) * 0.4} 0 0 0 0 0 1\n" for i in range(101))
    report = read_track.read_track(on(tmp_path, jitter), options=ReadOptions(start=EAST))
    (track,) = report.tracks
    assert (len(track.poses), track.skipped) == (1, 100)
    assert track.distance_m == pytest.approx(40.0, abs=1e-6)
    (whole,) = read_track.read_track(
        on(tmp_path, jitter), options=ReadOptions(start=EAST, min_move=ALL)
    ).tracks
    assert len(whole.poses) == 101
    assert whole.poses.travelled_m[-1] == pytest.approx(40.0, abs=1e-6)


def test_pieces_go_on_where_the_last_ended(tmp_path) -> None:
    rows = "".join(f"{i} {i * 0.3} 0 0 0 0 0 1\n" for i in range(5000))
    (track,) = read_track.read_track(on(tmp_path, rows), options=ReadOptions(start=EAST, min_move=ALL)).tracks
    assert len(track.poses) == 5000
    assert np.allclose(track.poses.travelled_m, np.arange(5000) * 0.3, atol=1e-5)
    assert track.poses.heading_deg == pytest.approx(90.0)


def test_a_robot_sees_objects_from_where_it_is(tmp_path) -> None:
    text = "t,x,y,yaw,id,class\n1,10,0,0,,\n2,10,5,1.5707963267948966,,\n3,10,7,,v1,victim\n"
    report = read_track.read_track(on(tmp_path, text), options=ReadOptions(start=EAST))
    (seen,) = report.sightings
    azimuth, _, metres = Geod(ellps="WGS84").inv(14.0, 50.0, seen.latlon.lon, seen.latlon.lat)
    assert (round(azimuth), round(metres, 6)) == (0, 7.0), "7 m to the left of one that looked east"


def test_sources_are_what_is_wished(tmp_path) -> None:
    (track,) = read_track.read_track(on(tmp_path, TEXTS["GPX"]), options=ReadOptions(source="manual")).tracks
    assert track.source == "manual"


def test_reading_can_be_stopped(tmp_path) -> None:
    class Stopped(Progress):
        def cancelled(self) -> bool:
            return True

    with pytest.raises(Cancelled):
        read_track.read_track(on(tmp_path, TEXTS["GPX"]), progress=Stopped())


SHARED = {
    "Mojstrovka.gpx": (184, 0),
    "cerknicko-without-times.gpx": (296, 7),
    "korita-zbevnica.gpx": (871, 2),
    "track-with-extremes.gpx": (25, 0),
    "unicode_with_bom.gpx": (0, 1),
    "badcoords.kml": (4, 0),
    "test1.bag": (989 + 3952, 0),
    "test2.bag": (3060, 0),
}
REFUSED = {
    "billion.kml": "declares a document type or entities",
    "lines.kml": "more than 100 lines: it is a drawing",
    "networklink.kml": "links to other files, which are not followed",
}


def test_every_real_file_is_read_or_refused_with_a_reason(shared_data) -> None:
    files = sorted(path.name for path in (shared_data / "robot").iterdir())
    assert set(files) == SHARED.keys() | REFUSED.keys()
    for name, (poses, objects) in SHARED.items():
        report = read_track.read_track(
            shared_data / "robot" / name, options=ReadOptions(start=EAST, min_move=ALL)
        )
        counted = sum(len(track.poses) for track in report.tracks)
        assert (counted, len(report.sightings)) == (poses, objects), name
    for name, message in REFUSED.items():
        begin = time.perf_counter()
        with pytest.raises(TrackError, match=message):
            read_track.read_track(shared_data / "robot" / name)
        assert time.perf_counter() - begin < 30.0, name


def test_the_way_of_a_real_bag_is_the_sum_over_its_fixes(shared_data) -> None:
    path = shared_data / "robot" / "test1.bag"
    with AnyReader([path]) as bag:
        chosen = [c for c in bag.connections if c.topic == "/fix"]
        fixes = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages(connections=chosen)]
    way = 0.0
    for a, b in itertools.pairwise(fixes):  # on a sphere of the mean radius
        lat, north = math.radians(a.latitude), math.radians(b.latitude - a.latitude)
        east = math.radians(b.longitude - a.longitude) * math.cos(lat)
        way += 6_371_000.0 * math.hypot(north, east)
    for min_move in (ALL, MinMove()):
        options = ReadOptions(topics=("/fix",), min_move=min_move)
        (track,) = read_track.read_track(path, options=options).tracks
        assert track.distance_m == pytest.approx(way, rel=0.01)
        assert len(track.poses) + track.skipped == len(fixes)


def test_a_track_that_is_not_wanted_still_says_where_objects_are(tmp_path):
    table = tmp_path / "log.csv"
    table.write_text("time,x,y,id\n1e9,3,2,\n1.1e9,9,2,\n1.1e9,103,2,box\n")
    options = ReadOptions(start=Start(LatLon(50.0, 14.0), 0.0), tracks=())
    report = read_track.read_track(table, options=options)
    (box,) = report.sightings
    assert report.tracks == () and report.skipped == ()
    assert box.latlon == pytest.approx((50.0 + 100 / 111_229, 14.0), abs=1e-7)
