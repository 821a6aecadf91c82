"""Files become tracks and objects of a mission: each pose once, even if the import is killed at any time."""

import json
from contextlib import contextmanager
from datetime import timedelta

import numpy as np
import pytest

from webapp.core.geo.types import LatLon
from webapp.errors import NotFound, TrackError
from webapp.files import gate
from webapp.files.exchange.gpx import NAMESPACE
from webapp.importing import import_name
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.store import batches, drawings, missions, objects, tracks
from webapp.missions.store.objects import Page
from webapp.missions.store.schema import Mission, Track
from webapp.missions.tasks import import_file, import_order, read_track
from webapp.missions.tasks.export import export_mission
from webapp.missions.tasks.import_order import Order
from webapp.missions.tasks.place_track import ReadOptions
from webapp.progress import Progress
from webapp.settings import Settings

ALL = ReadOptions(min_move=MinMove(0.0))


class Killed(BaseException):
    """Stands for a kill, which nothing may catch."""


@pytest.fixture
def log(tmp_path):
    """A table of two tracks with objects among their poses, read in many parts."""
    rows = ["time,lat,lon,track,id,class"]
    for i in range(900):
        rows.append(f"{1000 + i},{50 + i * 1e-5:.6f},14,{'ab'[i % 2]},,")
        if i % 300 == 7:
            rows.append(f"{1000 + i},{50 + i * 1e-5:.6f},14.1,,bin{i % 2},bin")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def mission(library, owner):
    """The id of a mission without tracks."""
    with library.database.write() as session:
        return missions.create(session, "Search", account_id=owner).id


@pytest.fixture
def small_parts(monkeypatch):
    """Read files in small parts, in this process, and store a few at a time."""
    monkeypatch.setattr(gate, "run", lambda target, arguments, **_: import_name(target)(**arguments))
    monkeypatch.setattr("webapp.missions.files.readers.csv_reader.CHUNK", 50)
    monkeypatch.setattr(import_file, "_AT_ONCE", 120)


def order_for(path, options=ALL, name=None):
    return Order(path, name or path.name, options)


def imported(library, mission, order, **how):
    return import_file.import_track_file(library, mission, order=order, settings=Settings(), **how)


def content(library, mission):
    """Return all that is stored: tracks with counts and poses, objects with sightings."""
    with library.database.read() as session:
        found = {}
        for track in tracks.list_tracks(session, mission):
            poses = tracks.read(session, track)
            facts = (track.poses, track.skipped, round(track.distance_m, 6))
            found[(track.source, track.name)] = (*facts, poses.times_s.tolist(), poses.latlon.tolist())
        seen = {
            o.object_id: (o.kind, o.sightings, o.last_time_s)
            for o in objects.page(session, mission, Page())[0]
        }
        return found, seen


def test_what_is_stored_is_what_is_read(library, mission, log, small_parts):
    done = imported(library, mission, order_for(log))
    whole = read_track.read_track(log, options=ALL)
    stored, seen = content(library, mission)
    assert {name for _, name in stored} == {"log a", "log b"}
    for track in whole.tracks:
        count, skipped, distance, times, latlon = stored[("gps", f"log {track.name}")]
        assert (count, skipped) == (450, 0)
        assert distance == pytest.approx(track.distance_m)
        assert times == track.poses.times_s.tolist()
        assert np.array_equal(latlon, track.poses.latlon)
    assert seen == {"bin1": ("bin", 3, 1607.0)}
    assert (done.objects, done.new) == (3, True)


def test_names_and_colours_of_a_file_are_taken_and_not_taken_again(library, mission, tmp_path):
    def feature(lon, **about):
        line = {"type": "LineString", "coordinates": [[lon, 50], [lon, 50.1]]}
        return {"type": "Feature", "geometry": line, "properties": {"name": "Ridge", **about}}

    path = tmp_path / "hike.geojson"
    features = [feature(14, stroke="#F0a", **{"stroke-width": 7}), feature(15, stroke="red")]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    imported(library, mission, order_for(path))

    def looks():
        with library.database.read() as session:
            return {row.name: tracks.look_of(row) for row in tracks.list_tracks(session, mission)}

    taken = {"hike line 1 Ridge": TrackLook("Ridge", "#ff00aa", 7.0), "hike line 2 Ridge": TrackLook()}
    assert looks() == taken  # two of one name could not be told apart
    with library.database.write() as session:
        (first, _) = tracks.list_tracks(session, mission)
        row = session.get_one(Mission, mission)
        tracks.change_look(session, row, id=first.id, fields={"title": "South", "colour": None})
    imported(library, mission, order_for(path))
    assert looks()["hike line 1 Ridge"] == TrackLook("South", None, 7.0)


@pytest.mark.parametrize("after_commit", [False, True])
def test_killed_anywhere_it_continues_and_stores_each_pose_once(
    library, mission, log, small_parts, after_commit
):
    with library.database.write() as session:
        other = missions.create(session, "Whole", account_id=session.get_one(Mission, mission).account_id).id
    imported(library, other, order_for(log))
    expected = content(library, other)
    kills = 0
    for survives in range(100):
        left = survives

        @contextmanager
        def write():
            nonlocal left
            with library.database.write() as session:
                yield session
                if left == 0 and not after_commit:
                    raise Killed
            if left == 0:
                raise Killed
            left -= 1

        try:
            imported(library, mission, order_for(log), writes=write)
            break
        except Killed:
            kills += 1
    assert kills > 3
    assert content(library, mission) == expected


def test_a_file_that_comes_again_stores_nothing(library, mission, log):
    imported(library, mission, order_for(log))
    before = content(library, mission)
    again = imported(library, mission, order_for(log))
    assert not again.new
    assert content(library, mission) == before
    with library.database.read() as session:
        revision = session.get_one(Mission, mission).revision
    imported(library, mission, order_for(log))
    with library.database.read() as session:
        assert session.get_one(Mission, mission).revision == revision, "open pages hear of nothing"


def test_read_in_another_way_it_makes_tracks_of_its_own(library, mission, log):
    imported(library, mission, order_for(log))
    done = imported(library, mission, order_for(log, ReadOptions(min_move=MinMove(100.0, "m"))))
    assert sorted(track.name for track in done.tracks) == ["log a (2)", "log b (2)"]
    assert all(track.skipped > 400 for track in done.tracks)


def test_the_distance_is_that_before_thinning(library, mission, tmp_path):
    path = tmp_path / "still.csv"
    path.write_text("time,lat,lon\n" + "".join(f"{i},50.00000{i % 2},14\n" for i in range(101)))
    (track,) = imported(library, mission, order_for(path, ReadOptions())).tracks
    assert (track.poses, track.skipped) == (1, 100)
    assert track.distance_m == pytest.approx(100 * 0.1112, rel=0.01)


def test_a_damaged_file_stores_nothing_and_is_called_by_its_name(library, mission, tmp_path):
    path = tmp_path / "0123.track"
    path.write_text('<gpx><trk><trkseg><trkpt lat="50" lon="14"/></trkseg></trk>')
    with pytest.raises(TrackError) as error:
        imported(library, mission, order_for(path, name="walk.gpx"))
    assert error.value.where == "walk.gpx"
    assert content(library, mission) == ({}, {})


def test_waypoints_of_two_files_stay_apart(library, mission, tmp_path):
    for lat, name in ((50, "a.gpx"), (51, "b.gpx")):
        path = tmp_path / name
        path.write_text(f'<gpx><wpt lat="{lat}" lon="14"><name>001</name></wpt></gpx>')
        imported(library, mission, order_for(path))
    assert set(content(library, mission)[1]) == {"a: waypoint 1 001", "b: waypoint 1 001"}


def test_objects_come_with_the_state_of_our_files_and_no_other(library, mission, tmp_path):
    path = tmp_path / "tasks.gpx"
    ours = "".join(
        f'<wpt lat="50.{n}" lon="14"><name>o</name><extensions><e:state>{state}</e:state></extensions></wpt>'
        for n, state in enumerate(("cleared", "Texas", ""))
    )
    path.write_text(f'<gpx xmlns:e="{NAMESPACE}">{ours}<wpt lat="51" lon="14"/></gpx>')
    imported(library, mission, order_for(path))
    with library.database.read() as session:
        found, _ = objects.page(session, mission, Page())
    assert [one.state for one in found] == ["cleared", "found", "found", "found"]
    assert {one.state_by for one in found} == {None}


def test_the_start_is_that_of_the_mission(library, mission, tmp_path):
    path = tmp_path / "way.tum"
    path.write_text("0 0 0 0 0 0 0 1\n1 100 0 0 0 0 0 1\n")
    with pytest.raises(TrackError, match="needs a start"):
        imported(library, mission, order_for(path))
    with library.database.write() as session:
        session.get_one(Mission, mission).start = {"lat": 50.0, "lon": 14.0, "heading_deg": 0.0}
    (track,) = imported(library, mission, order_for(path)).tracks
    assert track.source == "odometry"
    with library.database.read() as session:
        latlon = tracks.read(session, session.get_one(Track, track.id)).latlon
    assert latlon[1, 0] - 50.0 == pytest.approx(100 / 111_229, rel=1e-3)
    start = Start(LatLon(10.0, 10.0), 0.0)
    (other,) = imported(library, mission, order_for(path, ReadOptions(start=start))).tracks
    assert other.name == "way (2)"


def test_a_mission_in_the_bin_takes_nothing(library, mission, log):
    with library.database.write() as session:
        missions.put_into_bin(session.get_one(Mission, mission))
    with pytest.raises(NotFound, match="in the bin"):
        imported(library, mission, order_for(log))


def test_every_pose_and_object_is_a_step(library, mission, log):
    class Counted(Progress):
        total = steps = 0

        def size(self, total):
            self.total = total

        def advance(self, steps=1):
            self.steps += steps

    progress = Counted()
    imported(library, mission, order_for(log), progress=progress)
    assert progress.steps == progress.total == 903


@pytest.mark.parametrize(("times", "timed"), [((), False), ((700,), False), (range(440, 900), True)])
def test_a_track_is_timed_where_most_of_its_points_are(library, mission, tmp_path, small_parts, times, timed):
    rows = ["time,lat,lon", *(f"{1000 if i in times else ''},{50 + i * 1e-5:.6f},14" for i in range(900))]
    path = tmp_path / "walk.csv"
    path.write_text("\n".join(rows))
    done = imported(library, mission, order_for(path))
    with library.database.read() as session:
        assert [session.get(Track, one.id).timed for one in done.tracks] == [timed]


def test_a_file_is_known_again_after_the_keys_of_batches_are_forgotten(library, mission, log):
    imported(library, mission, order_for(log))
    before = content(library, mission)
    answer = {"digest": "", "stored": 0, "revision": 0}
    with library.database.write() as session:
        batches.remember(session, mission, "of a client", answer=answer)
    with library.database.write() as session:
        batches.remember(session, mission, "a later one", answer=answer, keep=timedelta(days=-1))
    with library.database.read() as session:
        assert batches.answered(session, mission, "of a client") is None
    assert not imported(library, mission, order_for(log)).new
    assert content(library, mission) == before


def test_the_options_in_an_import_key_are_written_as_in_0_7_0():
    options = ReadOptions(start=Start(LatLon(50.0, 14.0), 30.0), topics=("/fix",))
    assert import_order.options_key(options) == (
        "Wishes(start=Start(position=LatLon(lat=50.0, lon=14.0), heading_deg=30.0), "
        "min_move=MinMove(value=1e-05, unit='deg'), "
        "topics=('/fix',), columns=None, source=None)"
    )


def test_a_file_that_an_older_version_divided_otherwise_is_imported_once(library, mission, log, monkeypatch):
    whole = log.read_text()
    log.write_text("\n".join(line.replace(",a,", ",,").replace(",b,", ",,") for line in whole.splitlines()))
    order = order_for(log)
    key = import_file._key(order, Progress())
    monkeypatch.setattr(import_file, "_key", lambda _order, _progress: key)
    assert imported(library, mission, order).new
    before = content(library, mission)
    log.write_text(whole)  # stands for the same file, which is now read as two tracks
    again = imported(library, mission, order)
    assert not again.new
    assert content(library, mission) == before


def test_of_a_file_that_was_divided_otherwise_a_missing_part_is_not_hidden(
    library, mission, log, monkeypatch, small_parts
):
    whole = log.read_text()
    log.write_text("\n".join(line.replace(",a,", ",,").replace(",b,", ",,") for line in whole.splitlines()))
    order = order_for(log)
    key = import_file._key(order, Progress())
    monkeypatch.setattr(import_file, "_key", lambda _order, _progress: key)
    store, stored = import_file._store, []

    def killed_after_the_first(*args, **how):
        if stored:
            raise Killed
        stored.append(store(*args, **how))

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(import_file, "_store", killed_after_the_first)
        imported(library, mission, order)
    before = content(library, mission)
    log.write_text(whole)  # stands for the same file, which is now read as two tracks
    with pytest.raises(TrackError, match="only a part of the file") as error:
        imported(library, mission, order)
    assert (error.value.where, error.value.hint) == ("log.csv", "import it into a new mission")
    assert content(library, mission) == before


def test_drawings_of_our_geojson_come_once(library, mission, owner, tmp_path):
    with library.database.write() as session:
        row = session.get_one(Mission, mission)
        square = [(50.0, 14.0), (50.0, 14.001), (50.001, 14.001)]
        given = {"name": "Slope", "points": square, "assigned": "Ann", "searched": True, "radius_m": 7.0}
        drawings.add(session, row, kind="area", by="owner", fields=given)
        drawings.add(session, row, kind="marker", by="owner", fields={"name": "Post", "points": square[:1]})
        other = missions.create(session, "Other", account_id=owner).id
    download = export_mission(library, mission, form="geojson", people=True)
    path = tmp_path / "search.geojson"
    path.write_bytes(b"".join(download.pieces))
    done = [imported(library, other, order_for(path)) for _ in range(2)]
    assert [one.new for one in done] == [True, False]
    with library.database.read() as session:
        area, marker = drawings.list_drawings(session, other)
    assert drawings.points_of(area) == square
    assert (area.assigned, area.radius_m, area.searched_time_s is not None) == ("Ann", 7.0, True)
    assert {area.created_by, area.searched_by, marker.created_by} == {"search.geojson"}
    visitors = b"".join(export_mission(library, mission, form="geojson").pieces)
    assert b"Slope" in visitors
    assert b"Ann" not in visitors
