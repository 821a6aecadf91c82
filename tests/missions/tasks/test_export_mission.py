"""Exports of a mission are complete, with memory independent of its size."""

import csv
import io
import tracemalloc
import zipfile

import gpxpy
import numpy as np
import pytest
from PIL import Image

from tests.kml_rules import KML, check_kml
from webapp.errors import Conflict, NotFound, UsageError
from webapp.missions.store import reading, tracks
from webapp.missions.store.schema import Track
from webapp.missions.tasks import export


def whole(download):
    return b"".join(download.pieces)


@pytest.mark.parametrize("form", export.FORMATS)
def test_every_format_has_a_name_and_a_type(library, new_mission, form):
    download = export.export_mission(library, new_mission(name="Süd / 1"), form=form)
    assert download.name == ("Sud-1-objects.csv" if form == "objects.csv" else f"Sud-1.{form}")
    assert "/" in download.media_type
    assert whole(download)


def test_gpx_has_every_pose(library, new_mission, some_poses):
    gpx = gpxpy.parse(whole(export.export_mission(library, new_mission(5000), form="gpx")).decode())
    (track,) = gpx.tracks
    points = track.segments[0].points
    assert track.source == "gps" and len(gpx.waypoints) == 3
    ours = some_poses(5000)
    np.testing.assert_allclose([(p.latitude, p.longitude) for p in points], ours.latlon, atol=1e-9, rtol=0)
    np.testing.assert_allclose([p.time.timestamp() for p in points], ours.times_s, atol=1e-6, rtol=0)


def test_a_kmz_has_its_icons_inside(library, new_mission):
    archive = zipfile.ZipFile(io.BytesIO(whole(export.export_mission(library, new_mission(), form="kmz"))))
    assert archive.testzip() is None
    root = check_kml(archive.read("doc.kml"))
    named = [e.text for e in root.iter(f"{KML}href")]
    assert sorted(named) == sorted(set(archive.namelist()) - {"doc.kml"}) and len(named) == 2
    for name in named:
        assert Image.open(io.BytesIO(archive.read(name))).size == (export.SIDE, export.SIDE)


@pytest.mark.parametrize("kind", ["car", "victim", "Ω", "", "a\x00b", "house fire", "\U0001f525"])
def test_every_class_has_an_icon(kind):
    picture = Image.open(io.BytesIO(export.icon(kind)))
    assert picture.mode == "RGBA" and picture.getpixel((0, 0))[3] == 0
    assert picture.getpixel((14, 24))[3] == 255
    assert export.icon(kind) == export.icon(kind)


def test_icons_of_classes_differ():
    kinds = ("car", "victim", "house", "tree", "fire", "hazard", "box", "sign", "x", "y")
    assert len({export.icon(kind) for kind in kinds}) == len(kinds)


def test_fewer_poses_are_spread_evenly_with_first_and_last(library, new_mission, some_poses):
    mission = new_mission(10_001)
    rows = whole(export.export_mission(library, mission, form="csv", most=101)).decode().splitlines()[1:]
    times = [float(row.split(",")[4]) for row in rows]
    assert times == some_poses(10_001).times_s[::100].tolist()
    (track,) = reading.read(library.database, mission, most=101).tracks
    assert track.count == 101


def test_objects_come_in_parts(library, new_mission, monkeypatch):
    monkeypatch.setattr(reading, "_PART", 4)
    result = whole(export.export_mission(library, new_mission(1, objects=8), form="objects.csv")).decode()
    assert [row["id"] for row in csv.DictReader(io.StringIO(result))] == [f"o{n}" for n in range(8)]


def peak(pieces):
    """Return the peak memory, bytes, of consuming all pieces."""
    tracemalloc.start()
    size = sum(len(piece) for piece in pieces)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most, size


@pytest.fixture(scope="module")
def large(tmp_path_factory, some_poses):
    """A library with missions of 8000, 24 000 and 100 000 poses."""
    from webapp.missions.store import missions
    from webapp.store.library import open_library
    from webapp.store.schema import Account

    made = {}
    library = open_library(tmp_path_factory.mktemp("large") / "library")
    for n in (8_000, 24_000, 100_000):
        with library.database.write() as session:
            session.add(account := Account(name=str(n)))
            session.flush()
            mission = missions.create(session, str(n), account_id=account.id)
            track = tracks.get_or_create(session, mission.id, source="gps")
            tracks.append(session, track, some_poses(n))
        made[n] = mission.id
    yield library, made
    library.database.close()


@pytest.mark.parametrize(
    ("form", "poses"), [("kmz", 100_000), ("gpx", 24_000), ("geojson", 24_000), ("csv", 24_000)]
)
@pytest.mark.slow
def test_many_more_poses_take_no_more_memory(large, form, poses):
    library, made = large
    small, small_size = peak(export.export_mission(library, made[8_000], form=form).pieces)
    most, size = peak(export.export_mission(library, made[poses], form=form).pieces)
    assert size > poses / 8_000 * 0.9 * small_size
    assert most < 1.2 * small + 200_000 and most < 12_000_000


def test_a_track_that_is_rewritten_meanwhile_ends_no_file_early(library, new_mission):
    mission = new_mission(10_000)
    pieces = export.export_mission(library, mission, form="csv").pieces
    next(pieces), next(pieces)
    with library.database.write() as session:
        tracks.clear(session, session.query(Track).one())
    with pytest.raises(Conflict):
        list(pieces)


def test_poses_that_come_meanwhile_are_left_out(library, new_mission, some_poses):
    pieces = export.export_mission(library, new_mission(10), form="csv").pieces
    with library.database.write() as session:
        tracks.append(session, session.query(Track).one(), some_poses(5))
    assert len(b"".join(pieces).splitlines()) == 11


def test_what_does_not_exist_is_reported(library, new_mission):
    with pytest.raises(NotFound):
        export.export_mission(library, 77, form="kml")
    with pytest.raises(UsageError, match="unknown export format"):
        export.export_mission(library, new_mission(), form="exe")


def test_a_mission_without_poses_exports(library, new_mission):
    mission = new_mission(0, objects=0)
    for form in export.FORMATS:
        assert whole(export.export_mission(library, mission, form=form))
    check_kml(whole(export.export_mission(library, mission, form="kml")))


def test_a_link_fetches_again():
    link = export.export_network_link("Search", href="https://e.example/m/t/export.kmz", refresh_s=10)
    root = check_kml(whole(link))
    assert link.name == "Search-live.kml"
    assert root.find(f".//{KML}refreshInterval").text == "10"
