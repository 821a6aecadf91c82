"""Missions and their photos come back from a backup; older backups have none."""

import contextlib
import shutil
import sqlite3

import pytest

from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store import accounts, missions, snapshot, tracks
from webapp.store.library import DATABASE, open_library
from webapp.store.schema_missions import Pose
from webapp.tasks import add_mission_photo, backup_library, restore_library, take_batch
from webapp.tasks.add_mission_photo import About
from webapp.tasks.take_batch import Numbered


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def mission(library, save_photo):
    """A mission with three poses and a photo; gives its id."""
    with library.database.write() as session:
        id = missions.create(session, "Yard", account_id=accounts.ensure_owner(session).id).id
    poses = [{"type": "pose", "time": n, "lat": 50, "lon": 14} for n in range(3)]
    take_batch.run(library, id, records=poses, place=Numbered("robot", 0))
    save_photo(library.uploads / "a.jpg", 1)
    add_mission_photo.run(
        library, id, source=library.uploads / "a.jpg", name="a.jpg", about=About(), settings=Settings()
    )
    return id


def photo_of(library, mission):
    with library.database.read() as session:
        (photo,) = missions.photos(session, mission)
    return add_mission_photo.original(library, photo).read_bytes()


def test_a_mission_comes_back(library, mission, tmp_path):
    report = backup_library.run(library, tmp_path / "b.zip", progress=Progress())
    assert report.missing == ()
    restore_library.run(tmp_path / "b.zip", tmp_path / "other", progress=Progress())
    restored = open_library(tmp_path / "other")
    with restored.database.read() as session:
        (track,) = tracks.listed(session, mission)
        assert tracks.read(session, track).times_s.tolist() == [0, 1, 2]
        assert session.query(Pose).count() == 3
    assert photo_of(restored, mission) == photo_of(library, mission)
    assert not (missions.folder(restored, mission) / "derived").exists()
    restored.database.close()


def test_a_photo_that_is_lost_is_told_of(library, mission, tmp_path):
    shutil.rmtree(missions.folder(library, mission))
    report = backup_library.run(library, tmp_path / "b.zip", progress=Progress())
    (lost,) = report.missing
    assert lost.startswith(f"missions/{mission}/photos/")


def test_a_database_from_before_missions(library):
    path = library.inner / DATABASE
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("DROP TABLE mission_photo")
        database.commit()
    assert snapshot.check(path).mission_photos == frozenset()
