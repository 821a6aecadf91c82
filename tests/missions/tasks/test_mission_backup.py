"""Missions, their photos and fused tracks are restored from a backup; older backups contain none."""

import contextlib
import shutil
import sqlite3

import pytest
from filelock import FileLock

from tests.missions.core.simulated import Drive
from tests.missions.core.test_fusion import gps_of, odometry_of
from webapp.app.registry import LIBRARY_PARTS
from webapp.errors import StorageError
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Pose
from webapp.missions.tasks import add_photo, fuse, store_batch
from webapp.missions.tasks.add_photo import PhotoMetadata
from webapp.missions.tasks.store_batch import Numbered
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import DATABASE, open_library
from webapp.store.operate import snapshot
from webapp.store.schema import Account
from webapp.tasks.maps import adopt_map, export
from webapp.tasks.operate import backup
from webapp.tasks.operate.backup import readers


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def mission(library, save_photo):
    """The id of a mission with three poses and a photo."""
    with library.database.write() as session:
        id = missions.create(session, "Yard", account_id=accounts.ensure_owner(session).id).id
    poses = [{"type": "pose", "time": n, "lat": 50, "lon": 14} for n in range(3)]
    store_batch.store_batch(library, id, records=poses, place=Numbered("robot", 0))
    save_photo(library.uploads / "a.jpg", 1)
    add_photo.add_mission_photo(
        library,
        id,
        source=library.uploads / "a.jpg",
        name="a.jpg",
        about=PhotoMetadata(),
        settings=Settings(),
    )
    return id


def photo_of(library, mission):
    with library.database.read() as session:
        (photo,) = missions.photos(session, mission)
    return add_photo.original(library, photo).read_bytes()


def test_a_mission_comes_back(library, mission, tmp_path):
    report = backup.back_up(library, tmp_path / "b.zip", parts=LIBRARY_PARTS, progress=Progress())
    assert report.missing == ()
    backup.restore(tmp_path / "b.zip", tmp_path / "other", parts=LIBRARY_PARTS, progress=Progress())
    restored = open_library(tmp_path / "other")
    with restored.database.read() as session:
        (track,) = tracks.list_tracks(session, mission)
        assert tracks.read(session, track).times_s.tolist() == [0, 1, 2]
        assert session.query(Pose).count() == 3
    assert photo_of(restored, mission) == photo_of(library, mission)
    assert not (missions.folder(restored, mission) / "derived").exists()
    restored.database.close()


def test_a_photo_that_is_lost_is_reported(library, mission, tmp_path):
    shutil.rmtree(missions.folder(library, mission))
    report = backup.back_up(library, tmp_path / "b.zip", parts=LIBRARY_PARTS, progress=Progress())
    (lost,) = report.missing
    assert lost.startswith(f"missions/{mission}/photos/")


@pytest.fixture
def fused(library):
    """The id of a mission without photos whose tracks were fused."""
    drive = Drive(3)
    drive.measured[20] += (0, 90)
    with library.database.write() as session:
        id = missions.create(session, "Drive", account_id=accounts.ensure_owner(session).id).id
        for source, poses in (("odometry", odometry_of(drive)), ("gps", gps_of(drive))):
            tracks.append(session, tracks.get_or_create(session, id, source=source), poses)
    fuse.fuse_mission(library, id, write=library.database.write, progress=Progress())
    return id


def fused_track(library, mission):
    with library.database.read() as session:
        track = next(t for t in tracks.list_tracks(session, mission) if t.source == "fused")
        return track.id, tracks.read(session, track).latlon.tolist()


def test_a_fused_track_comes_back_with_its_report(library, fused, tmp_path):
    report = backup.back_up(library, tmp_path / "b.zip", parts=LIBRARY_PARTS, progress=Progress())
    assert report.missing == ()
    backup.restore(tmp_path / "b.zip", tmp_path / "other", parts=LIBRARY_PARTS, progress=Progress())
    restored = open_library(tmp_path / "other")
    assert fused_track(restored, fused) == fused_track(library, fused)
    assert fuse.read_report(restored, fused) == fuse.read_report(library, fused)
    assert fuse.read_report(restored, fused)["gated"]
    restored.database.close()


def test_a_backup_waits_while_a_fused_track_is_replaced(library, fused, tmp_path, monkeypatch):
    monkeypatch.setattr(backup, "_WAIT_S", 0)
    with (
        FileLock(library.inner / fuse.LOCK),
        pytest.raises(StorageError, match="the fused track of a mission, which is still being written"),
    ):
        backup.back_up(library, tmp_path / "b.zip", parts=LIBRARY_PARTS, progress=Progress())


def test_tracks_are_fused_while_a_backup_waits_for_a_map(library, fused, make_map, tmp_path, monkeypatch):
    monkeypatch.setattr(backup, "_WAIT_S", 0)
    make_map(library.map_folder("park"), 2)
    with library.database.read() as session:
        owner = session.query(Account).one().id
    adopt_map.adopt_map(library, "park", account_id=owner)
    held, asked = backup._held, []

    def noted(path, **named):
        asked.append(path.name)
        return held(path, **named)

    monkeypatch.setattr(backup, "_held", noted)
    (library.map_folder("park") / "derived").mkdir(exist_ok=True)
    with (
        FileLock(library.map_folder("park") / "derived" / export.LOCK),
        pytest.raises(
            StorageError, match=r"the \.cfg file of a map, which is still being written"
        ) as refused,
    ):
        backup.back_up(library, tmp_path / "b.zip", parts=LIBRARY_PARTS, progress=Progress())
    assert refused.value.where == "park"
    assert asked == [export.LOCK]


def test_a_database_from_before_missions(library):
    path = library.inner / DATABASE
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("DROP TABLE mission_photo")
        database.commit()
    assert snapshot.check(path, readers=readers(LIBRARY_PARTS)).parts["missions"].files == frozenset()
