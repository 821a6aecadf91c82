"""Maps on a server and a global descriptor: it is used once the map is described and calibrated with it."""

from dataclasses import replace

import pytest
from sqlalchemy import func, select, update

from tests.standin_models import tiny_image
from webapp.progress import Progress
from webapp.settings import ExtractSettings
from webapp.store.schema import Job, MapRecord
from webapp.tasks.localize import build_map, readiness
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto
from webapp.tasks.maps import adopt_map


@pytest.fixture
def small(library, owner, make_map):
    """The id and file of a map of six photos in the library."""
    make_map(library.map_folder("small"), 6)
    return adopt_map.adopt_map(library, "small", account_id=owner.id), library.cfg("small")


@pytest.fixture
def server(settings, tmp_path):
    """Settings with an empty folder for models."""
    (tmp_path / "models").mkdir()
    extract = ExtractSettings(max_side_px=320, keypoints=120)
    return replace(settings, models=tmp_path / "models", extract=extract)


def build(cfg, settings):
    options = OpenOptions(method="verified", features="sift", jobs=1)
    build_map.build_map(cfg, options, settings=settings, progress=Progress())


def described(opened):
    return opened.pipeline.opened.indexed.global_descriptors is not None


def same_map(one, other):
    """Return whether both share one opened index."""
    return one.pipeline.opened.indexed is other.pipeline.opened.indexed


def test_it_is_taken_when_it_is_there_and_left_out_when_it_is_gone(library, small, server):
    map_id, cfg = small
    build(cfg, server)
    maps = MapCache(library, server)
    plain = maps.get(map_id, OpenOptions("verified"))
    assert (described(plain), plain.to_calibrate) == (False, False)
    assert same_map(maps.get(map_id, OpenOptions("verified")), plain)

    model = server.models / "global.onnx"
    model.write_bytes(tiny_image())
    waiting = maps.get(map_id, OpenOptions("verified"))
    assert (described(waiting), waiting.to_calibrate, waiting.calibrated) == (False, True, True)

    build(cfg, server)
    ready = maps.get(map_id, OpenOptions("verified"))
    assert (described(ready), ready.to_calibrate, ready.calibrated) == (True, False, True)
    assert same_map(maps.get(map_id, OpenOptions("verified")), ready)
    photo = cfg.parent / "photos" / "3.jpg"
    assert ready.pipeline.localize(photo, top=1).hypotheses[0].experiences[0] == 3

    model.unlink()
    again = maps.get(map_id, OpenOptions("verified"))
    assert (described(again), again.to_calibrate) == (False, False)
    before, after = (p.pipeline.localize(photo, top=9).hypotheses for p in (plain, again))
    assert before == after


def test_a_model_that_cannot_be_used_leaves_nothing_to_do(library, small, server):
    map_id, cfg = small
    build(cfg, server)
    (server.models / "global.onnx").write_bytes(b"no network")
    opened = MapCache(library, server).get(map_id, OpenOptions("verified"))
    assert (described(opened), opened.to_calibrate) == (False, False)


def test_a_job_describes_the_map_once_for_each_model(library, small, server):
    map_id, cfg = small
    build(cfg, server)
    (server.models / "global.onnx").write_bytes(tiny_image())
    maps = MapCache(library, server)
    photo = UploadedPhoto(cfg.parent / "photos" / "3.jpg", "3.jpg")
    request = LocalizeRequest((photo,), options=OpenOptions("verified", "sift"))

    def ask():
        """Answer, and count the jobs that this queued."""
        with library.database.write() as session:
            session.execute(update(Job).values(state="done", ended_at=func.now()))
            before = {job.id for job in session.scalars(select(Job))}
            record = session.get_one(MapRecord, map_id)
        readiness.localize_or_build(maps, record, request=request)
        with library.database.read() as session:
            return len({job.id for job in session.scalars(select(Job))} - before)

    assert [ask(), ask()] == [1, 0]
    (server.models / "global.json").write_text('{"mean": [0, 0, 0]}')
    assert [ask(), ask()] == [1, 0]
