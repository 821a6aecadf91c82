"""Maps on a server with a second look: the first answers until the second is built, and builds finish."""

from dataclasses import replace

import pytest

from tests.standin_models import write_aliked
from webapp.core.hypotheses import looks
from webapp.progress import Progress
from webapp.settings import ExtractSettings
from webapp.tasks.localize import build_map
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.maps import adopt_map

AUTO = OpenOptions(jobs=1)


@pytest.fixture
def with_models(settings, tmp_path):
    """Settings with the models of ALIKED."""
    models = write_aliked(tmp_path / "models")
    return replace(settings, models=models, extract=ExtractSettings(max_side_px=320, keypoints=120))


@pytest.fixture
def small(library, owner, make_map):
    """The id and file of a map of six photos in the library."""
    make_map(library.map_folder("small"), 6)
    return adopt_map.adopt_map(library, "small", account_id=owner.id), library.cfg("small")


def build(cfg, settings, options=AUTO):
    build_map.build_map(cfg, options, settings=settings, progress=Progress())


def test_one_look_answers_until_the_other_is_built(library, small, with_models, monkeypatch):
    map_id, cfg = small
    build(cfg, with_models, replace(AUTO, method="verified", features="sift"))
    maps = MapCache(library, with_models)
    waiting = maps.get(map_id, OpenOptions())
    assert len(waiting.pipeline.looks) == 1 and waiting.to_calibrate
    build(cfg, with_models)
    ready = maps.get(map_id, OpenOptions())
    assert len(ready.pipeline.looks) == 2
    assert (ready.to_calibrate, ready.calibrated, ready.not_indexed) == (False, True, 0)
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    answer = ready.pipeline.localize(cfg.parent / "photos" / "3.jpg", top=3)
    assert answer.looks == ("sift", "aliked")
    assert ready.pipeline.method == "auto"


def test_where_there_is_no_time_for_it_nothing_is_left_to_do(library, small, with_models):
    map_id, cfg = small
    hasty = replace(with_models, retrieval=replace(with_models.retrieval, budget_s=1e-9))
    build(cfg, hasty)
    opened = MapCache(library, hasty).get(map_id, OpenOptions())
    assert len(opened.pipeline.looks) == 1
    assert not opened.to_calibrate


def test_a_broken_model_leaves_the_first_look(library, small, with_models):
    map_id, cfg = small
    build(cfg, with_models)
    (with_models.models / "aliked.onnx").write_bytes(b"no network")
    opened = MapCache(library, with_models).get(map_id, OpenOptions())
    assert len(opened.pipeline.looks) == 1
    assert opened.pipeline.localize(cfg.parent / "photos" / "3.jpg", top=3).looks == ("sift",)


def test_a_method_that_is_asked_for_by_name_has_one_look(library, small, with_models):
    map_id, cfg = small
    build(cfg, with_models)
    opened = MapCache(library, with_models).get(map_id, OpenOptions("verified"))
    assert (len(opened.pipeline.looks), opened.pipeline.method) == (1, "verified")
    assert opened.pipeline.features == "sift"
