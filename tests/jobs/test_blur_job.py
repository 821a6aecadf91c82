"""The job that finds faces and plates in the photos of a map."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.standin_models import install_blur_networks
from webapp.app.registry import REGISTRY
from webapp.jobs.worker import Worker
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map


@pytest.fixture
def row(library, make_map):
    """Id of a map of three photos; all but the first have a white spot."""
    cfg = make_map(library.map_folder("row"), 3)
    for number in range(3):
        pixels = np.full((240, 320, 3), number, np.uint8)
        pixels[96:112, 192 : 192 + 16 * (number > 0)] = 255
        cv2.imwrite(str(cfg.parent / "photos" / f"{number}.jpg"), pixels)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    return adopt_map.adopt_map(library, "row", account_id=owner.id)


@pytest.fixture
def work(library, settings, tmp_path, monkeypatch):
    folder = install_blur_networks(tmp_path / "models", monkeypatch.setitem)
    return Worker(library, replace(settings, models=folder), registry=REGISTRY)


def blurred(library, id):
    with library.database.read() as session:
        return [bool(p.blurred) for p in maps.photos(session, session.get_one(MapRecord, id))]


def test_it_only_looks_until_it_is_to_accept(library, work, queue, seen, row):
    id = queue("blur", map_id=row)
    work.run(once=True)
    result = seen(id)["result"]
    assert seen(id)["state"] == "done", seen(id)["error"]
    assert (result["searched"], result["photos"], result["blurred"], result["missing"]) == (3, 2, 0, [])
    assert blurred(library, row) == [False, False, False]
    again = queue("blur", map_id=row, arguments={"accept": True, "least_score": 0.9})
    work.run(once=True)
    assert (seen(again)["state"], seen(again)["result"]["blurred"]) == ("done", 2)
    assert blurred(library, row) == [False, True, True]
    once_more = queue("blur", map_id=row, arguments={"accept": True})
    work.run(once=True)
    assert seen(once_more)["result"]["blurred"] == 0


def test_photos_of_a_map_without_an_image_are_searched(library, work, queue, seen, row):
    cfg = library.cfg("row")
    for name in (cfg, cfg.with_name("map.json")):
        name.unlink(missing_ok=True)
    id = queue("blur", map_id=row)
    work.run(once=True)
    assert seen(id)["state"] == "done", seen(id)["error"]
    assert seen(id)["result"]["photos"] == 2


def test_without_networks_the_job_says_what_is_missing(library, settings, tmp_path, queue, seen, row):
    id = queue("blur", map_id=row)
    Worker(library, replace(settings, models=tmp_path / "none"), registry=REGISTRY).run(once=True)
    assert seen(id)["state"] == "failed"
    assert "expmap models fetch faces plates" in seen(id)["error"]["hint"]
