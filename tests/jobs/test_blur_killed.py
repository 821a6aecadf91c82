"""A worker that blurs a whole map is killed at every step: the next one blurs the rest, and nothing twice."""

import operator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.killing import Step, run_until
from tests.standin_models import install_blur_networks
from webapp.app.registry import REGISTRY
from webapp.files.photos.photo import preview_path
from webapp.jobs.worker import Worker
from webapp.settings import JobSettings, Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.operate import job_views, jobs
from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map

PHOTOS = 4

STEPS = [
    Step("webapp.tasks.blur.find:DetectionCache.add"),
    Step("webapp.tasks.blur.find:DetectionCache.add", calls=1, is_after=True),
    Step("webapp.tasks.blur.find:blur_photo"),
    Step("webapp.tasks.maps.pictures:write_previews"),
    Step("webapp.files.photos.photo:write_bytes", is_after=True),
    Step("webapp.tasks.maps.pictures:release_boxes", is_after=True),
    Step("webapp.tasks.blur.find:blur_photo", is_after=True),
    Step("webapp.tasks.maps.pictures:write_previews", calls=1, is_after=True),
    Step("webapp.store.operate.jobs:finish"),
]
"""In the order of the work, each of which begins where the last one was killed."""


def spotted_map(library, make_map):
    """Return the id of a map to blur: all photos but the first have a spot that the networks find."""
    cfg = make_map(library.map_folder("row"), PHOTOS)
    for number in range(PHOTOS):
        pixels = np.full((240, 320, 3), number, np.uint8)
        pixels[96:112, 192 : 192 + 16 * (number > 0)] = 255
        cv2.imwrite(str(cfg.parent / "photos" / f"{number}.jpg"), pixels)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    id = adopt_map.adopt_map(library, "row", account_id=owner.id)
    with library.database.write() as session:
        jobs.enqueue(session, "blur", map_id=id, arguments={"accept": True})
    return id


def work(settings):
    """Run the jobs of a library, as a worker does."""
    install_blur_networks(settings.models, operator.setitem)
    library = open_library(settings.library, url=settings.database)
    Worker(library, settings, registry=REGISTRY).run(once=True)
    library.database.close()


def photos_of(library, map_id):
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        return record.revision, {photo.id: boxes_of(photo) for photo in maps.photos(session, record)}


def previews(library, blurred):
    """Return the blurred pictures of the photos that are recorded as blurred."""
    return {
        (id, kind): preview_path(library.map_folder("row"), id, kind=kind, blurred=boxes).read_bytes()
        for id, boxes in blurred.items()
        for kind in ("preview", "thumb")
        if boxes
    }


@pytest.fixture
def settings(library, database_url, tmp_path):
    limits = JobSettings(attempts=len(STEPS) + 1)
    return replace(
        Settings(), library=library.folder, database=database_url, jobs=limits, models=tmp_path / "models"
    )


@pytest.fixture
def undisturbed(tmp_path, make_map, settings, monkeypatch):
    """Revision, boxes and pictures of a map that was blurred without a kill."""
    install_blur_networks(settings.models, monkeypatch.setitem)
    library = open_library(tmp_path / "undisturbed")
    id = spotted_map(library, make_map)
    there = replace(settings, library=library.folder, database=None)
    Worker(library, there, registry=REGISTRY).run(once=True)
    revision, blurred = photos_of(library, id)
    library.database.close()
    return revision, blurred, previews(library, blurred)


@pytest.mark.slow
def test_blurring_a_map_goes_on_after_each_kill(library, settings, make_map, undisturbed):
    revision, blurred, pictures = undisturbed
    assert [bool(boxes) for boxes in blurred.values()] == [False, True, True, True]
    id = spotted_map(library, make_map)
    before, boxes = photos_of(library, id)
    for step in STEPS:
        assert run_until(step, work, settings), step
        now, found = photos_of(library, id)
        assert all(found[photo] in ([], blurred[photo]) for photo in blurred), step
        assert {photo for photo in boxes if boxes[photo]} <= {photo for photo in found if found[photo]}, step
        assert now - before == sum(map(bool, found.values())), "one revision per photo"
        assert previews(library, found).items() <= pictures.items(), step
        boxes = found
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert photos_of(library, id) == (revision, blurred)
    assert previews(library, blurred) == pictures
    with library.database.read() as session:
        (job,) = [job_views.to_json(session, one) for one in session.query(jobs.Job).filter_by(kind="blur")]
    assert (job["state"], job["result"]["searched"], job["result"]["failed"]) == ("done", PHOTOS, [])
    lines = next(library.map_folder("row").glob("derived/blur/*.jsonl")).read_bytes().split()
    assert sum(line.startswith(b'{"photo"') for line in lines) == PHOTOS, "each photo was searched once"
