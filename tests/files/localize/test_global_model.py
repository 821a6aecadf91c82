"""`global.onnx` and `global.json` in the folder of models, and the vectors of a map's photos."""

import json

import numpy as np
import pytest

from tests.standin_models import passed_on, tiny_image
from webapp.errors import InputError
from webapp.files.localize import global_vectors
from webapp.files.localize.global_vectors import StoredVectors
from webapp.files.localize.models import global_descriptor, global_model_problem, usable_global_descriptor


@pytest.fixture
def supply(tmp_path):
    """Put a model and its JSON into a folder."""

    def put(model=None, form=None):
        (tmp_path / "global.onnx").write_bytes(tiny_image() if model is None else model)
        if form is not None:
            text = form if isinstance(form, str) else json.dumps(form)
            (tmp_path / "global.json").write_text(text)
        return tmp_path

    return put


def test_without_a_model_there_is_none_and_nothing_is_wrong(tmp_path):
    assert global_descriptor(tmp_path) is None
    assert global_model_problem(tmp_path) == ""


def test_the_json_beside_it_states_size_and_normalisation(supply):
    stated = {"width": 32, "height": 24, "mean": [0.5, 0.5, 0.5], "std": [0.25, 0.25, 0.25]}
    network = global_descriptor(supply(tiny_image("w", "h"), stated))
    assert (network.width, network.height) == (32, 24)


def test_it_is_opened_once_until_its_files_change(supply):
    folder = supply()
    first = global_descriptor(folder)
    assert global_descriptor(folder) is first
    other = global_descriptor(supply(form={"mean": [0, 0, 0]}))
    assert other is not first
    assert other.weights != first.weights, "other vectors"
    assert global_descriptor(supply(tiny_image(32, 24))).weights not in (first.weights, other.weights)


@pytest.mark.parametrize(
    ("model", "form", "sentence"),
    [
        (b"no model", None, "global.onnx: not a global descriptor model that onnxruntime can run"),
        (tiny_image("w", "h"), None, "global.onnx: not a global descriptor: its input width is not fixed"),
        (None, "{", "global.json: it is not JSON"),
        (None, '{"width": "64"}', "global.json: width is not a whole number"),
        (None, "[" * 100_000, "global.json: "),
        (None, {"height": 99}, "global.onnx: not a global descriptor: its input height is 48"),
        (
            passed_on(8, 8, scale=np.nan),
            None,
            "global.onnx: not a global descriptor: its vectors are zero",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(supply, model, form, sentence):
    folder = supply(model, form)
    assert global_model_problem(folder).startswith(sentence)
    assert "\n" not in global_model_problem(folder) and str(folder) not in global_model_problem(folder)


def test_a_model_that_cannot_be_opened_is_not_read_again(supply, monkeypatch):
    folder = supply(b"no model")
    assert usable_global_descriptor(folder) is None
    monkeypatch.setattr("webapp.files.localize.models.read_model", lambda path: pytest.fail("read again"))
    assert usable_global_descriptor(folder) is None
    with pytest.raises(InputError):
        global_descriptor(folder)


def test_vectors_come_back_and_only_for_their_model(tmp_path):
    path = tmp_path / "map" / global_vectors.file_name("one")
    assert global_vectors.read(path, weights="one") is None
    vectors = np.eye(3, 5, dtype=np.float16)
    global_vectors.write(path, StoredVectors(["a", "b", "c"], vectors, "one"))
    found = global_vectors.read(path, weights="one")
    assert found.contents == ["a", "b", "c"] and (found.vectors == vectors).all()
    assert global_vectors.read(path, weights="one") is found, "read once"
    assert global_vectors.read(path, weights="other") is None
    path.write_bytes(path.read_bytes()[:-64])
    assert global_vectors.read(path, weights="one") is None
