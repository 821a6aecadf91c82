"""The worker writes files of a map that are older than its records."""

import logging

import cv2
import numpy as np
import pytest

from webapp.app.registry import REGISTRY
from webapp.errors import StorageError
from webapp.jobs.worker import Worker
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import export, photo_files


@pytest.fixture
def late(library, park):
    """A map whose record has an image and a photo, but whose files were not written."""
    folder = library.map_folder("park")
    folder.mkdir()
    cv2.imwrite(str(folder / "plan.png"), np.zeros((20, 30), np.uint8))
    with library.database.write() as session:
        record = session.get(MapRecord, park)
        record.satellite_path, record.satellite_width, record.satellite_height = "plan.png", 30, 20
        record.revision, record.next_id = 3, 1
        session.add(
            Photo(
                map_id=park, id=0, name="a.jpg", path="photos/a.jpg", sha256="0" * 64, size_bytes=1,
                width=4, height=3, x_px=5.0, y_px=6.0,
            )
        )  # fmt: skip
    return library.cfg("park")


def test_the_worker_writes_what_a_killed_request_has_not(library, settings, late):
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert late.read_text() == "plan.png;30;20\n0;photos/a.jpg;5;6\n"
    with library.database.read() as session:
        assert session.get(MapRecord, 1).exported_revision == 3


def test_files_follow_while_a_long_job_runs_and_after_a_kill(library, late, queue, seen, start, wait_for):
    def move(x):
        with library.changing(1) as change:
            edits.apply(
                change.session, change.record, changes={"photo/0": {"x_px": x}}, kind="move", account_id=1
            )

    def written(x):
        return lambda: late.exists() and late.read_text().endswith(f"\n0;photos/a.jpg;{x};6\n")

    worker = start()
    id = queue("count", arguments={"steps": 4000, "seconds": 0.05})
    wait_for(lambda: seen(id)["state"] == "running")
    for x in (7.0, 8.0, 9.0):
        move(x)
    wait_for(written(9))
    worker.kill()
    worker.wait()
    move(10.0)
    assert written(9)()
    start()
    wait_for(written(10))


def test_many_quick_edits_cost_few_exports(library, settings, late, monkeypatch):
    exports = []
    monkeypatch.setattr(export, "write_map", lambda _cfg, map_: exports.append(map_.revision))
    for x in range(20):
        with library.changing(1) as change:
            at = {"photo/0": {"x_px": float(x)}}
            edits.apply(change.session, change.record, changes=at, kind="move", account_id=1)
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert exports == [change.record.revision]


def test_what_cannot_be_written_is_reported_and_stops_nothing(library, settings, late, monkeypatch, caplog):
    def refuse(_library, _id):
        raise StorageError("the disk is full")

    monkeypatch.setattr(export, "export_map", refuse)
    with caplog.at_level(logging.WARNING):
        Worker(library, settings, registry=REGISTRY).run(once=True)
    assert "the disk is full" in caplog.text


def test_a_file_that_cannot_be_read_stops_no_worker(library, settings, late, caplog):
    late.mkdir()
    with caplog.at_level(logging.WARNING):
        Worker(library, settings, registry=REGISTRY).run(once=True)
    assert "the files of map 1 are not current" in caplog.text


def test_what_cannot_be_swept_of_one_map_leaves_the_others(library, settings, late, monkeypatch, caplog):
    swept = []

    def refuse(_library, map_id):
        swept.append(map_id)
        raise PermissionError("you may not")

    with library.database.write() as session:
        other = maps.create(session, "Other", account_id=1).id
    monkeypatch.setattr(photo_files, "sweep_orphans", refuse)
    with caplog.at_level(logging.WARNING):
        Worker(library, settings, registry=REGISTRY).run(once=True)
    assert sorted(swept) == [1, other]
    assert "you may not" in caplog.text


def test_a_job_that_outlives_its_map_leaves_no_folder(library, settings, registry, park, queue):
    queue("outlive", map_id=park)
    Worker(library, settings, registry=registry).run(once=True)
    assert [path.name for path in library.folder.iterdir()] == [".library"]
