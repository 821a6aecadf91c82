"""Method `thorough`: requirements and answers."""

from dataclasses import replace

import pytest

from tests.opening import open_first_look
from webapp.core.retrieval import retrieve
from webapp.errors import MissingPart
from webapp.files.localize import models as files
from webapp.progress import Progress
from webapp.tasks.localize import build_map
from webapp.tasks.localize.open_index import with_positions
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

THOROUGH = OpenOptions(method="thorough", jobs=1)


def test_photos_are_matched_by_the_network_and_calibrated_for_it(
    tmp_path, make_map, quick, shared_models, monkeypatch
):
    matched = []
    original = retrieve.rematch_with_network
    monkeypatch.setattr(
        "webapp.core.localize.verified.rematch_with_network",
        lambda *given, **named: matched.append(given) or original(*given, **named),
    )
    cfg = make_map(tmp_path, 6)
    settings = replace(quick, models=shared_models)
    localizer = open_pipeline(cfg, THOROUGH, settings=settings, progress=Progress())
    matched.clear()
    answer = localizer.localize(tmp_path / "photos" / "3.jpg", top=3)
    assert len(matched) == 1
    assert localizer.features == "xfeat"
    assert answer.hypotheses[0].experiences[0] == localizer.map.experiences[3].id
    assert localizer.opened.folder.folder.joinpath("calibration-thorough-ivf.json").exists()


def test_positions_that_change_keep_the_network(tmp_path, make_map, quick, shared_models):
    settings = replace(quick, models=shared_models)
    opened = open_first_look(make_map(tmp_path, 3), THOROUGH, settings=settings, progress=Progress())
    again = with_positions(opened, opened.map)
    assert again.indexed.pair_matcher is opened.indexed.pair_matcher is not None


def test_missing_weights_are_reported_before_anything_is_built(tmp_path, make_map, quick, shared_models):
    models = tmp_path / "models"
    models.mkdir()
    weights = files.installed("xfeat", shared_models)
    (models / weights.name).write_bytes((shared_models / weights.name).read_bytes())
    cfg = make_map(tmp_path, 2)
    for run in (open_first_look, build_map.build_map):
        with pytest.raises(MissingPart, match="lighterglue") as missing:
            run(cfg, THOROUGH, settings=replace(quick, models=models), progress=Progress())
        assert "expmap models fetch" in missing.value.hint
    assert not (tmp_path / "derived").exists()


def test_what_can_be_chosen_depends_on_the_weights_that_are_here(tmp_path, shared_models):
    assert files.usable_methods(tmp_path) == ["auto", "vote", "verified", "landmarks"]
    assert "xfeat" not in files.usable_features(tmp_path)
    assert "sift" in files.usable_features(tmp_path)
    assert files.usable_methods(shared_models) == ["auto", "vote", "verified", "thorough", "landmarks"]
    assert "xfeat" in files.usable_features(shared_models)
    assert "disk" not in files.usable_features(shared_models)
    assert files.usable_features(tmp_path, method="thorough") == []
    assert files.usable_features(shared_models, method="thorough") == ["xfeat"]


def test_features_fit_the_method_thorough_where_their_matcher_is_here_too(tmp_path):
    (tmp_path / "aliked.onnx").touch()
    assert "aliked" in files.usable_features(tmp_path)
    assert files.usable_features(tmp_path, method="thorough") == []
    (tmp_path / "aliked_lightglue.onnx").touch()
    assert files.usable_features(tmp_path, method="thorough") == ["aliked"]
    assert "thorough" not in files.usable_methods(tmp_path)
