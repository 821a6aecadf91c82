"""`expmap models`, and what is said where weights are missing."""

import json

import pytest


@pytest.fixture(autouse=True)
def models(tmp_path, monkeypatch):
    """No weights are here."""
    folder = tmp_path / "models"
    monkeypatch.setenv("EXPMAP_MODELS", str(folder))
    return folder


def test_the_list_tells_size_licence_source_and_state(expmap):
    code, out, err = expmap("models", "list")
    assert code == 0
    assert "xfeat_800x576.onnx, 4.1 MB, Apache-2.0, XFeat of" in out
    assert out.count("missing") == 2
    assert "folder:" in err
    code, out, _ = expmap("models", "list", "--json")
    assert {state["model"] for state in json.loads(out)} == {"xfeat"}


def test_weights_from_a_folder_can_be_used(expmap, shared_models, models):
    code, out, err = expmap("models", "fetch", "xfeat", "--from", shared_models)
    assert code == 0
    assert out.strip() == str(models / "xfeat_800x576.onnx")
    assert "Apache-2.0" in err
    assert expmap("models", "fetch")[0::2] == (0, "all are here\n")
    assert "; here" in expmap("models", "list")[1]


def test_an_empty_folder_is_an_error_that_says_where_to_get_them(expmap, tmp_path):
    code, out, err = expmap("models", "fetch", "--from", tmp_path)
    assert (code, out) == (1, "")
    assert "xfeat_640x640.onnx" in err
    assert "verlab/accelerated_features" in err


def test_features_without_their_weights_end_with_the_line_that_gets_them(expmap, sample_folder):
    code, _, err = expmap("build", sample_folder / "map.cfg", "--features", "xfeat")
    assert code == 4
    assert "expmap models fetch" in err
