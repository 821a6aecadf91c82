"""Networks that are written here are what OpenCV reads, and their weights are read back."""

from contextlib import suppress

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.onnx_writer import Writer
from webapp.core.features.onnx import (
    Convolution,
    Graph,
    cut_after,
    read_convolutions,
    read_interface,
    with_products,
)


def random_layer(rng, out, channels, side):
    weight = rng.normal(size=(out, channels, side, side)).astype(np.float32)
    return Convolution(weight, rng.normal(size=out).astype(np.float32))


@pytest.fixture
def network():
    rng = np.random.default_rng(3)
    first, second = random_layer(rng, 5, 1, 3), random_layer(rng, 2, 5, 1)
    graph = Graph()
    halved = graph.convolution("first", graph.input("image", 1), of=first, stride=2, relu=True)
    smooth = graph.convolution("second", halved, of=second, relu=False)
    graph.sigmoid(
        "answer", graph.sum("twice", of=(graph.enlarge("large", smooth, times=2), graph.input("more", 2)))
    )
    return first, second, graph.to_bytes([("answer", 2)])


def test_weights_are_read_back_under_the_names_of_the_outputs(network):
    first, second, model = network
    found = read_convolutions(model)
    assert list(found) == ["first", "second"]
    for layer, expected in zip(found.values(), (first, second), strict=True):
        assert np.array_equal(layer.weight, expected.weight)
        assert np.array_equal(layer.bias, expected.bias)


@pytest.mark.parametrize("shape", [(8, 12), (20, 6)])
def test_opencv_computes_the_layers_for_any_size(network, shape):
    (weight, bias), (mix, shift), model = network
    rng = np.random.default_rng(4)
    image, more = rng.normal(size=shape).astype(np.float32), rng.normal(size=(2, *shape)).astype(np.float32)
    net = cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))
    net.setInput(image[None, None], "image")
    net.setInput(more[None], "more")
    answer = net.forward("answer")[0]

    edges = [cv2.filter2D(image, -1, w[0], borderType=cv2.BORDER_CONSTANT)[::2, ::2] for w in weight]
    halved = np.maximum(np.stack(edges) + bias[:, None, None], 0.0)
    smooth = np.einsum("oc,chw->ohw", mix[:, :, 0, 0], halved) + shift[:, None, None]
    large = np.stack([cv2.resize(s, shape[::-1], interpolation=cv2.INTER_LINEAR) for s in smooth])
    assert np.abs(answer - 1.0 / (1.0 + np.exp(-(large + more)))).max() < 1e-5


def test_a_model_that_is_cut_gives_its_layers_and_computes_no_others(network):
    (weight, bias), _, model = network
    short = cut_after(model, ["first.relu", "first"])
    assert list(read_convolutions(short)) == ["first"]
    image = np.random.default_rng(4).normal(size=(8, 12)).astype(np.float32)
    net = cv2.dnn.readNetFromONNX(np.frombuffer(short, np.uint8))
    net.setInput(image[None, None], "image")
    net.setInput(np.zeros((1, 2, 8, 12), np.float32), "more")
    positive, first = net.forward(["first.relu", "first"])
    edges = [cv2.filter2D(image, -1, w[0], borderType=cv2.BORDER_CONSTANT)[::2, ::2] for w in weight]
    assert np.abs(first[0] - np.stack(edges) - bias[:, None, None]).max() < 1e-5
    assert np.array_equal(positive, np.maximum(first, 0.0))


def test_what_a_model_takes_and_gives_is_read(network):
    assert read_interface(network[-1]) == (
        {"image": (1, 1, None, None), "more": (1, 2, None, None)}, {"answer"}
    )  # fmt: skip
    other = Writer()
    other.input("photo", -1, 3, "height", 640)
    other.input("number")
    other.output("a", 5)
    other.output("b")
    assert read_interface(other.to_bytes()) == ({"photo": (None, 3, None, 640), "number": ()}, {"a", "b"})


@given(st.binary(max_size=300), st.integers(0, 400))
def test_any_bytes_have_an_interface_or_none(data, cut):
    model = Writer()
    model.input("photo", 1, 3)
    model.output("a", 5)
    for file in (data, model.to_bytes()[:cut] + data, model.to_bytes() + data):
        with suppress(ValueError):
            inputs, outputs = read_interface(file)
            assert isinstance(inputs, dict)
            assert isinstance(outputs, set)


@pytest.mark.parametrize(
    ("equation", "kept"),
    [
        ("bnd,bmd->bnm", False),
        ("b h i j, b h j d -> b h i d", False),
        ("bhid,bhjd->bhij", False),
        ("ij,kj->ik", False),
        ("ij,jk->ik", False),
        ("ij,kj->ki", True),
        ("iij,ikj->iik", True),
    ],
)
def test_an_einsum_that_is_a_product_of_matrices_is_computed_for_any_sizes(equation, kept):
    one, other = equation.replace(" ", "").split("->")[0].split(",")
    rng, model = np.random.default_rng(2), Writer()
    for name, letters in (("one", one), ("other", other)):
        model.input(name, *(f"{name}{letter}" for letter in letters))
    model.node("Einsum", "one", "other", name="answer", equation=equation)
    model.output("answer", *"xyzw"[: len(one)])
    written = with_products(model.to_bytes())
    assert (b"Einsum" in written) == kept
    if kept:
        assert sorted(written) == sorted(model.to_bytes())  # at most in another order
        return
    net = cv2.dnn.readNetFromONNX(np.frombuffer(written, np.uint8))
    for _ in range(3):
        sides = {letter: int(rng.integers(1, 9)) for letter in one + other}
        a, b = (rng.normal(size=[sides[i] for i in letters]).astype(np.float32) for letters in (one, other))
        net.setInput(a, "one")
        net.setInput(b, "other")
        expected = np.einsum(equation.replace(" ", ""), a, b)
        assert np.abs(net.forward("answer").reshape(expected.shape) - expected).max() < 1e-4


def test_what_is_no_model_has_no_products():
    for wrong in (b"", b"\xff" * 40, b"no model at all"):
        with pytest.raises(ValueError, match=r"model|digits"):
            with_products(wrong)
