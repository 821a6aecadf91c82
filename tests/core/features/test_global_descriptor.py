"""A user's model: its input image is read from the model or stated; errors are reported."""

import numpy as np
import pytest

from tests.onnx_writer import Writer
from tests.standin_models import passed_on, tiny_image
from webapp.core.features.global_descriptor import GlobalDescriptor, InputForm, read_form
from webapp.errors import InputError, MissingPart


def opened(model, **stated):
    return GlobalDescriptor(model, file="global.onnx", form=InputForm(**stated), weights="w")


def test_size_comes_from_the_models_own_input():
    network = opened(tiny_image(64, 48))
    assert (network.width, network.height) == (64, 48)
    vector = network.describe(np.random.default_rng(0).integers(0, 256, (90, 77, 3)).astype(np.uint8))
    assert vector.shape == (16 * 12 * 3,) and vector.dtype == np.float32
    assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-5)


def test_what_the_model_leaves_open_is_stated():
    network = opened(tiny_image("w", "h"), width=40, height=24)
    assert (network.width, network.height) == (40, 24)
    assert network.describe(np.full((9, 9, 3), (0, 9, 99), np.uint8)).shape == (3 * 10 * 6,)


def test_metadata_of_the_model_is_read_and_what_is_stated_goes_before():
    stated = [("width", "32"), ("height", "16"), ("mean", "[0.5, 0.5, 0.5]"), ("author", "somebody")]
    model = tiny_image("w", "h", metadata=stated)
    assert (opened(model).width, opened(model).height) == (32, 16)
    assert opened(model, width=48).width == 48
    with pytest.raises(InputError, match="metadata is wrong: width is not a whole number from 8 to 2048"):
        opened(tiny_image("w", "h", metadata=[("width", "0.5")]))


def test_colours_are_red_green_blue_from_0_to_1_and_normalised():
    blue = np.full((8, 8, 3), (255, 0, 0), np.uint8)
    form = {"width": 8, "height": 8, "mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}
    planes = opened(passed_on(), **form).describe(blue).reshape(3, 8, 8)
    assert (planes[:2] == 0.0).all() and np.allclose(planes[2], 1.0 / 8.0)
    form |= {"mean": (0.0, 0.0, 0.5), "std": (1.0, 1.0, 2.0)}
    assert np.allclose(opened(passed_on(), **form).describe(blue).reshape(3, 8, 8)[2], 1.0 / 8.0)
    usual = opened(passed_on(8, 8)).describe(blue).reshape(3, 8, 8)[:, 0, 0]
    imagenet = np.array([-0.485 / 0.229, -0.456 / 0.224, (1.0 - 0.406) / 0.225])
    assert np.allclose(usual / usual[0], imagenet / imagenet[0], atol=1e-4)


def two_inputs():
    g = Writer()
    g.node("Add", g.input("a", 1, 3, 8, 8), g.input("b", 1, 3, 8, 8), name="sum")
    g.output("sum", 1, 3, 8, 8)
    return g.to_bytes()


def an_image():
    g = Writer()
    g.node("Relu", g.input("image", 1, 3, 8, 8), name="image out")
    g.output("image out", 1, 3, 8, 8)
    return g.to_bytes()


BAD = {
    "damaged": (tiny_image()[:100], "not a global descriptor model that onnxruntime can run"),
    "no model": (b"anything", "not a global descriptor model that onnxruntime can run"),
    "two inputs": (two_inputs(), "it has 2 inputs instead of one image"),
    "two outputs": (passed_on(8, 8, outputs=("x", "y")), "it has 2 outputs instead of one vector"),
    "an image as output": (
        an_image(),
        r"its output has the shape \(1, 3, 8, 8\) instead of \(1, d\)",
    ),
    "any size": (passed_on(), "its input width is not fixed, and none is stated"),
    "any height": (passed_on(8), "its input height is not fixed, and none is stated"),
}


@pytest.mark.parametrize("name", BAD)
def test_another_model_is_refused_in_one_sentence(name):
    model, message = BAD[name]
    with pytest.raises(InputError, match=message) as refused:
        opened(model)
    assert refused.value.where == "global.onnx"
    assert "docs/features.md" in refused.value.hint
    assert "\n" not in str(refused.value)


def test_an_input_of_another_shape_is_refused():
    g = Writer()
    g.node("Flatten", g.input("image", 1, 8, 8, 3), axis=1, name="vector")
    g.output("vector", 1, "d")
    with pytest.raises(InputError, match=r"input has the shape \(1, 8, 8, 3\) instead of \(1, 3, height"):
        opened(g.to_bytes())


def test_a_stated_size_that_the_model_does_not_take_is_refused():
    with pytest.raises(InputError, match="its input width is 64, but 48 is stated"):
        opened(tiny_image(64, 48), width=48)


@pytest.mark.parametrize("scale", [np.nan, np.inf, 0.0])
def test_a_vector_without_numbers_is_refused(scale):
    network = opened(passed_on(8, 8, scale=scale))
    with pytest.raises(InputError, match="its vectors are zero or contain values that are not finite"):
        network.describe(np.full((8, 8, 3), 99, np.uint8))


def test_several_vectors_are_refused():
    g = Writer()
    g.node("ReduceMax", g.input("image", 1, 3, 8, 8), name="vector", axes=[0, 3], keepdims=0)
    g.output("vector", "n", "d")
    with pytest.raises(InputError, match=r"an array of shape \(3, 8\) instead of one vector"):
        opened(g.to_bytes()).describe(np.full((8, 8, 3), 99, np.uint8))


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ([320, 240], "it is not an object"),
        ({"size": 320}, "unknown field 'size'; known: width, height, mean, std"),
        ({"width": 4}, "width is not a whole number from 8 to 2048"),
        ({"width": True}, "width is not"),
        ({"height": "240"}, "height is not"),
        ({"mean": 0.5}, "mean is not a list of three numbers from -1000 to 1000"),
        ({"mean": [0.5, 0.5]}, "mean is not"),
        ({"mean": [0.5, 0.5, float("nan")]}, "mean is not"),
        ({"std": [0.5, 0.5, 0]}, "std is not a list of three numbers from 0.001 to 1000"),
        ({"std": [0.5, "0.5", 1]}, "std is not"),
        ({"std": [0.5, 0.5, 1e39]}, "std is not"),
    ],
)
def test_a_wrong_form_is_refused(stated, message):
    with pytest.raises(ValueError, match=message):
        read_form(stated)


def test_a_form_states_what_it_states():
    stated = {"width": 322, "mean": [0, 0.5, 1], "std": None}
    assert read_form(stated) == InputForm(width=322, mean=(0.0, 0.5, 1.0))
    assert read_form({}) == InputForm()


def test_without_onnxruntime_the_line_that_installs_it_is_said(absent):
    absent("learned")
    with pytest.raises(MissingPart, match="onnxruntime is not installed") as missing:
        opened(tiny_image())
    assert "experience-map[learned]" in missing.value.hint
