"""Method `auto`: a second look with learned features if the first is uncertain and the model installed."""

import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.standin_models import write_aliked
from webapp.core.hypotheses import looks
from webapp.files.photos import photo as photo_files
from webapp.progress import Progress
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.localize import build_map, cascade, query_photo, trials
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import Look
from webapp.tasks.localize.plan import OpenOptions

AUTO = OpenOptions(jobs=1)


@pytest.fixture
def with_models(quick, tmp_path):
    """Settings with the models of ALIKED."""
    return replace(quick, models=write_aliked(tmp_path / "models"))


@pytest.fixture
def cfg(make_map, tmp_path):
    return make_map(tmp_path / "map", 6)


def open_auto(cfg, settings, **options):
    return open_pipeline(cfg, replace(AUTO, **options), settings=settings, progress=Progress())


def ask(pipeline, cfg, number=3):
    return pipeline.localize(cfg.parent / "photos" / f"{number}.jpg", top=3)


def test_without_models_it_is_the_first_look(cfg, quick, tmp_path):
    pipeline = open_auto(cfg, replace(quick, models=tmp_path / "none"))
    assert len(pipeline.looks) == 1
    assert (pipeline.method, pipeline.features) == ("auto", "sift")
    assert ask(pipeline, cfg).looks == ("sift",)


def test_an_unsure_answer_gets_a_second_look_and_a_sure_one_does_not(cfg, with_models, monkeypatch):
    pipeline = open_auto(cfg, with_models)
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    both = ask(pipeline, cfg)
    assert both.looks == ("sift", "aliked")
    assert both.hypotheses[0].experiences[0] == pipeline.map.experiences[3].id
    total = sum(h.probability for h in both.hypotheses) + both.other_probability + both.off_map_probability
    assert total == pytest.approx(1.0)
    monkeypatch.setattr(looks, "CERTAIN", 0.0)
    assert ask(pipeline, cfg).looks == ("sift",)


def test_the_first_look_is_reported_before_the_second(cfg, with_models, monkeypatch):
    pipeline, photo = open_auto(cfg, with_models), cfg.parent / "photos" / "3.jpg"
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    first = []
    both = pipeline.localize(photo, top=3, on_first=first.append)
    assert [answer.looks for answer in (*first, both)] == [("sift",), ("sift", "aliked")]
    alone = replace(pipeline, looks=pipeline.looks[:1]).localize(photo, top=3)
    assert first[0].hypotheses == alone.hypotheses
    monkeypatch.setattr(looks, "CERTAIN", 0.0)
    pipeline.localize(photo, top=3, on_first=first.append)
    assert len(first) == 1


def test_both_looks_decode_a_photo_once(cfg, with_models, monkeypatch):
    pipeline, read = open_auto(cfg, with_models), []
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    decode = photo_files.read_gray
    monkeypatch.setattr(query_photo, "read_gray", lambda *a, **k: read.append(a) or decode(*a, **k))
    assert ask(pipeline, cfg).looks == ("sift", "aliked")
    assert len(read) == 1


def test_the_network_matches_the_best_photos_only(cfg, with_models):
    pipeline = open_auto(cfg, with_models)
    indexed = pipeline.looks[1].opened.indexed
    assert indexed.pair_matcher is not None
    assert indexed.rematched == indexed.tuning.retrieval.second_look_photos
    assert pipeline.opened.indexed.pair_matcher is None


def test_whoever_names_features_gets_these_alone(cfg, with_models):
    assert not open_auto(cfg, with_models, features="orb").looks[1:]
    assert not open_auto(cfg, with_models, method="verified").looks[1:]


def test_without_a_budget_there_is_one_look(cfg, with_models):
    none = replace(with_models, retrieval=replace(with_models.retrieval, budget_s=0.0))
    assert not open_auto(cfg, none).looks[1:]
    little = replace(with_models, retrieval=replace(with_models.retrieval, budget_s=1e-9))
    assert not open_auto(cfg, little).looks[1:]


def test_a_busy_machine_during_the_calibration_does_not_cost_the_second_look(cfg, with_models, monkeypatch):
    find = trials.find_places

    def waiting(*args, **options):
        time.sleep(0.5)
        return find(*args, **options)

    monkeypatch.setattr(trials, "find_places", waiting)
    quick = replace(with_models, retrieval=replace(with_models.retrieval, budget_s=0.4))
    assert open_auto(cfg, quick).looks[1:]


def test_both_are_built_and_calibrated_together_once(cfg, with_models, monkeypatch):
    report = build_map.build_map(cfg, AUTO, settings=with_models, progress=Progress())
    assert (report.features, report.second.features) == ("sift", "aliked")
    monkeypatch.setattr(trials, "_try", lambda *a, **k: pytest.fail("it has been tried"))
    pipeline = open_auto(cfg, with_models)
    assert len(pipeline.looks) == 2
    assert pipeline.both.cases == 6


def test_the_newest_index_is_the_first_look_unless_it_is_that_of_the_second(cfg, with_models):
    build_map.build_map(cfg, AUTO, settings=with_models, progress=Progress())
    assert open_auto(cfg, with_models).features == "sift"
    build_map.build_map(cfg, replace(AUTO, features="orb"), settings=with_models, progress=Progress())
    pipeline = open_auto(cfg, with_models)
    assert [look.features for look in pipeline.looks] == ["orb", "aliked"]


def test_photos_are_hidden_from_both_looks(cfg, with_models, monkeypatch):
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    pipeline = with_hidden_photos(open_auto(cfg, with_models))
    own = pipeline.map.experiences[2]
    answer = pipeline.localize(cfg.parent / own.photo, top=5, hide=frozenset({own.id}))
    assert answer.looks == ("sift", "aliked")
    assert all(own.id not in h.experiences for h in answer.hypotheses)


def test_after_a_build_of_both_the_method_verified_takes_the_first(cfg, with_models):
    build_map.build_map(cfg, AUTO, settings=with_models, progress=Progress())
    assert open_auto(cfg, with_models, method="verified").features == "sift"
    none = replace(with_models, retrieval=replace(with_models.retrieval, budget_s=0.0))
    assert open_auto(cfg, none).features == "sift"


def test_an_index_of_the_second_looks_features_alone_is_taken(cfg, with_models):
    build_map.build_map(cfg, replace(AUTO, features="aliked"), settings=with_models, progress=Progress())
    pipeline = open_auto(cfg, with_models)
    assert [look.features for look in pipeline.looks] == ["aliked"]


def test_features_put_together_by_hand_get_a_second_look_too(cfg, with_models):
    mixed = replace(AUTO, detector="sift", extractor="orb")
    build_map.build_map(cfg, mixed, settings=with_models, progress=Progress())
    pipeline = open_auto(cfg, with_models)
    assert [look.features for look in pipeline.looks] == ["sift+orb", "aliked"]


def test_each_set_of_options_has_a_calibration_of_its_own(cfg, with_models):
    few = replace(with_models, retrieval=replace(with_models.retrieval, shortlist=3))
    names = set()
    for settings, options in ((with_models, {}), (few, {}), (with_models, {"map_kind": "schematic"})):
        pipeline = open_auto(cfg, settings, **options)
        names.add(cascade.path(pipeline.opened, pipeline.looks[1].opened).name)
    assert len(names) == 3


def test_a_model_that_does_not_work_leaves_the_first_look(cfg, with_models):
    (with_models.models / "aliked.onnx").write_bytes(b"no network")
    pipeline = open_auto(cfg, with_models)
    assert [look.features for look in pipeline.looks] == ["sift"]


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_photo_on_its_side_is_turned_upright_for_the_second_look(
    cfg, with_models, tmp_path, monkeypatch, quarters
):
    """The first look detects the orientation; matches refer to the photo as received."""
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    pipeline = open_auto(cfg, with_models)
    looked_at, looking = [], Look.localize

    def look(self, photo, **options):
        answer = looking(self, photo, **options)
        looked_at.append((photo, answer))
        return answer

    monkeypatch.setattr(Look, "localize", look)
    own = cfg.parent / "photos" / "3.jpg"
    on_its_side = tmp_path / "on-its-side.png"
    with Image.open(own) as photo:
        photo.rotate(90 * quarters, expand=True).save(on_its_side)
    answer = pipeline.localize(on_its_side, top=3)
    (first, _), (second, by_second) = looked_at
    assert answer.quarter_turns == quarters
    upright = np.rot90(first.gray.pixels, -quarters)
    assert np.array_equal(second.gray.pixels, upright)
    assert answer.hypotheses[0].experiences[0] == pipeline.map.experiences[3].id
    back = second.turned_back(by_second, quarters=quarters).evidence[0]
    assert back.inlier.sum() > 10
    turned = pil_rotated(back.photo_xy[back.inlier], upright.shape, quarters)
    assert np.median(np.abs(back.query_xy[back.inlier] - turned)) < 2.0


def pil_rotated(xy, shape, quarters):
    """Return pixels of a photo of (height, width), rotated counterclockwise like Pillow."""
    height, width = shape
    for _ in range(quarters):
        xy = np.column_stack([xy[:, 1], width - 1 - xy[:, 0]])
        height, width = width, height
    return xy
