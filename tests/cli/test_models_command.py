"""`expmap models`, and messages about missing weights."""

import json
import re
from dataclasses import replace

import pytest

from tests.standin_models import brightest, tiny_image
from webapp.files.localize.models import MODELS


@pytest.fixture(autouse=True)
def models(tmp_path, monkeypatch):
    """A folder of models without weights."""
    folder = tmp_path / "models"
    monkeypatch.setenv("EXPMAP_MODELS", str(folder))
    return folder


def test_the_list_has_size_licence_source_and_state(expmap):
    code, out, err = expmap("models", "list")
    assert code == 0
    assert "xfeat_800x576.onnx, 4.1 MB, Apache-2.0, XFeat of" in out
    assert "faces: face_detection_yunet_2023mar.onnx, 0.2 MB, MIT, YuNet of" in out
    assert "plates: license_plate_detection_lpd_yunet_2023mar.onnx, 4.1 MB, Apache-2.0, LPD-YuNet of" in out
    assert "aliked: aliked.onnx, to be supplied by you: no published file is pinned, ALIKED of" in out
    files = [file for same in MODELS.values() for file in same]
    assert out.count("; missing\n") == out.count("\n") == len(files)
    assert "folder:" in err
    code, out, _ = expmap("models", "list", "--json")
    names = [state["model"] for state in json.loads(out)]
    assert names == [name for name, files in MODELS.items() for _ in files]
    assert {"xfeat", "lighterglue", "faces", "plates", "aliked", "aliked-lightglue", "global"} < {*names}


def test_a_global_descriptor_is_named_and_tried(expmap, models):
    models.mkdir()
    (models / "global.onnx").write_bytes(tiny_image())
    said = "global: global.onnx, to be supplied by you: no published file is pinned, a global descriptor"
    code, out, _ = expmap("models", "list")
    line = out.splitlines()[-1]
    assert code == 0 and line.startswith(said) and line.endswith("; here")
    (models / "global.json").write_text('{"width": 20}')
    code, out, err = expmap("models", "list")
    problem = "global.onnx: not a global descriptor: its input width is 64"
    assert (
        code == 0
        and f"; unusable: {problem}, but 20 is stated (see 'A global descriptor' in" in out.splitlines()[-1]
    )
    state = json.loads(expmap("models", "list", "--json")[1])[-1]
    assert state["state"] == "unusable" and state["problem"].startswith(problem)
    assert "Traceback" not in err


def test_weights_from_a_folder_can_be_used(expmap, shared_models, models, monkeypatch):
    for model in ("faces", "plates"):  # they would be downloaded
        monkeypatch.delitem(MODELS, model)
    monkeypatch.setitem(MODELS, "lighterglue", (replace(MODELS["lighterglue"][0], address=""),))
    code, out, err = expmap("models", "fetch", "xfeat", "--from", shared_models)
    assert code == 0
    assert out.strip() == str(models / "xfeat_800x576.onnx")
    assert "Apache-2.0" in err
    assert "; here" in expmap("models", "list")[1]
    code, out, err = expmap("models", "fetch")
    assert (code, out) == (0, "")
    assert err.startswith("lighterglue: not fetched; copy lighterglue_L3.onnx from a folder")
    assert expmap("models", "fetch", "--from", shared_models)[0] == 0
    assert expmap("models", "fetch")[0::2] == (0, "all models are already installed\n")


def test_a_list_ends_with_what_is_missing_and_a_check_finds_nothing_to_check(expmap):
    assert "xfeat and lighterglue not installed (6.5 MB)" in expmap("models", "list")[2]
    assert expmap("models", "check", "--json") == (0, "[]\n", "")
    assert "run expmap models fetch" in expmap("models", "check")[2]


def test_a_check_prints_a_line_for_each_model(expmap, models):
    models.mkdir()
    (models / "disk.onnx").write_bytes(brightest("disk", count=50))
    code, out, _ = expmap("models", "check")
    assert code == 0 and re.fullmatch(r"disk: \d+ inliers of \d+ matches, \d+ ms\n", out)
    (models / "aliked.onnx").write_bytes(b"no network")
    code, out, err = expmap("models", "check")
    assert code == 1 and "aliked: unusable: aliked.onnx" in out and "Traceback" not in err


def test_an_empty_folder_is_an_error_that_says_where_to_get_them(expmap, tmp_path):
    code, out, err = expmap("models", "fetch", "--from", tmp_path)
    assert (code, out) == (1, "")
    assert "xfeat_640x640.onnx" in err
    assert "verlab/accelerated_features" in err


def test_features_without_their_weights_end_with_the_line_that_gets_them(expmap, sample_folder):
    code, _, err = expmap("build", sample_folder / "map.cfg", "--features", "xfeat")
    assert code == 4
    assert "expmap models fetch" in err


def test_a_model_of_ones_own_is_not_fetched(expmap):
    code, out, err = expmap("models", "fetch", "disk")
    assert (code, out) == (2, "")
    assert "put it as disk.onnx into the folder that expmap models list prints" in err


@pytest.mark.parametrize("features", ["aliked", "disk"])
def test_features_with_a_model_of_ones_own_say_how_to_supply_it(expmap, sample_folder, models, features):
    code, _, err = expmap("build", sample_folder / "map.cfg", "--features", features)
    assert code == 4
    assert f"put it as {features}.onnx into the folder" in err
    models.mkdir()
    (models / f"{features}.onnx").write_bytes(b"no model at all")
    code, _, err = expmap("build", sample_folder / "map.cfg", "--features", features)
    assert code == 1
    assert "model that onnxruntime can run" in err
    assert "Traceback" not in err


def test_a_map_with_a_model_of_ones_own_has_an_index_for_each_file(expmap, tmp_path, make_map, models):
    cfg = make_map(tmp_path / "map", 2)
    models.mkdir()
    for count in (300, 200):
        (models / "disk.onnx").write_bytes(brightest("disk", count=count))
        code, out, err = expmap("build", cfg, "--features", "disk", "--method", "vote", "--json")
        assert code == 0, err
        assert json.loads(out)["descriptors"] == 2 * count
        assert "WARN" not in err
    assert len(list((tmp_path / "map").glob("derived/map/disk-*"))) == 2
    photo = tmp_path / "map" / "photos" / "1.jpg"
    code, out, err = expmap("localize", cfg, photo, "--features", "disk", "--method", "vote", "--json")
    assert code == 0, err
