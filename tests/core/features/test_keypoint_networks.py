"""ALIKED and DISK, with stand-in models whose keypoints are the brightest pixels."""

from functools import partial

import numpy as np
import pytest

from tests.standin_models import TABLE, brighter, brightest, glue
from webapp.core.features.extract import extract
from webapp.core.features.table import EXTRACTORS, choose
from webapp.core.features.types import unit_as_bytes
from webapp.errors import InputError, MissingPart, UsageError
from webapp.threads import in_threads

KINDS = ("aliked", "disk")
DOTS = [(3, 5), (70, 8), (10, 60), (20, 30), (99, 41)]
"""Pixels, the brightest first."""


@pytest.fixture
def opened():
    """Make a network of a stand-in."""

    def make(kind, model):
        return EXTRACTORS[kind].model.load(model, f"{kind}.onnx")

    return make


def dotted(shape, *, times=1):
    """A dark photo with DOTS, each of `times` x `times` pixels."""
    gray = np.random.default_rng(1).integers(0, 40, shape, dtype=np.uint8)
    for i, (x, y) in enumerate(DOTS):
        gray[times * y : times * (y + 1), times * x : times * (x + 1)] = 250 - 20 * i
    return gray


def features(kind, network, *, gray, keypoints=5, **more):
    choice = choose("verified", features=kind)
    return extract(gray, choice, keypoints=keypoints, network=network, **more)


def described(width, pixels=DOTS):
    """Return the stand-in's descriptors of pixels of an image of a width."""
    rows = TABLE[[(y * width + x) % 64 for x, y in pixels]]
    return unit_as_bytes(rows / np.linalg.norm(rows, axis=1, keepdims=True))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("shape", "across"), [((64, 128), 128), ((71, 101), 128), ((96, 130), 160)])
def test_keypoints_of_a_photo_of_any_size_are_at_their_pixels(opened, kind, shape, across):
    found = features(kind, opened(kind, brightest(kind)), gray=dotted(shape))
    assert np.abs(found.xy - DOTS).max() < 1e-3
    assert found.photo_size == shape[::-1]
    assert not found.angle.any()
    assert (found.size > 1).all()
    padded = across if kind == "aliked" else shape[1] + -shape[1] % 16
    assert np.abs(found.descriptors.astype(int) - described(padded)).max() <= 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("shape", "takes", "times"),
    [
        ((80, 112), (80, 112), 1),
        ((72, 112), (80, 112), 1),
        ((80, 101), (80, 112), 1),
        ((160, 224), (80, 112), 2),
        ((160, 224), (128, 112), 2),
        ((246, 336), (96, 112), 3),
    ],
)
def test_a_model_for_one_size_is_shown_the_photo_undistorted(opened, kind, shape, takes, times):
    """Squares become single pixels only if both sides shrink alike."""
    gray = dotted(shape, times=times)
    found = features(kind, opened(kind, brightest(kind, size=takes)), gray=gray)
    assert np.abs(found.xy - ((np.array(DOTS) + 0.5) * times - 0.5)).max() < 0.05 * times
    assert (found.descriptors == described(112)).mean() > 0.99


@pytest.mark.parametrize("kind", KINDS)
def test_a_small_photo_is_enlarged_for_a_model_for_one_size(opened, kind):
    gray = np.zeros((36, 56), np.uint8)
    gray[20, 30] = 255
    found = features(kind, opened(kind, brightest(kind, size=(80, 112))), gray=gray, keypoints=4)
    assert np.abs(found.xy.mean(axis=0) - (30, 20)).max() < 1e-3
    assert np.abs(found.xy - (30, 20)).max() < 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_places_are_those_of_the_full_photo(opened, kind):
    gray = dotted((64, 128))
    found = features(kind, opened(kind, brightest(kind)), gray=gray, scale=0.5, photo_size=(256, 128))
    assert np.abs(found.xy - (np.array(DOTS) * 2 + 0.5)).max() < 1e-3
    assert found.photo_size == (256, 128)


@pytest.mark.parametrize("kind", KINDS)
def test_keypoints_outside_the_photo_are_dropped(opened, kind):
    gray = dotted((70, 101))
    gray[:, -1] = gray[-1] = 251  # repeated as padding, this makes the rest bright
    found = features(kind, opened(kind, brightest(kind, count=3000)), gray=gray, keypoints=1000)
    assert len(found) >= 170
    assert (found.xy < (100.5, 69.5)).all()
    assert len(np.unique(np.rint(found.xy), axis=0)) == len(found)


@pytest.mark.parametrize("kind", KINDS)
def test_without_texture_or_keypoints_there_is_nothing(opened, kind):
    network = opened(kind, brighter(kind))
    for gray in (np.full((64, 96), 255, np.uint8), dotted((64, 96)) // 4, np.full((1, 1), 7, np.uint8)):
        found = features(kind, network, gray=gray)
        assert found.xy.shape == (0, 2)
        assert found.descriptors.shape == (0, 128)
    assert len(features(kind, network, gray=dotted((64, 128)), keypoints=9)) == 5


@pytest.mark.parametrize("kind", KINDS)
def test_each_thread_and_each_order_of_sizes_gives_the_same(opened, kind):
    network = opened(kind, brightest(kind))
    rng = np.random.default_rng(5)
    shapes = [(96, 128), (160, 64), (64, 64), (96, 128)] * 3
    photos = [rng.integers(0, 256, shape, dtype=np.uint8) for shape in shapes]
    ask = partial(features, kind, network, keypoints=30)
    alone = [ask(gray=p) for p in photos]
    together = in_threads(lambda p: ask(gray=p), photos)
    for one, other in zip(alone, together, strict=True):
        assert len(one) == 30
        assert np.array_equal(one.xy, other.xy)
        assert np.array_equal(one.descriptors, other.descriptors)


@pytest.mark.parametrize("kind", KINDS)
def test_another_file_is_one_clear_error(opened, kind):
    good = brightest(kind)
    for wrong in (b"", b"no model at all" * 99, b"\xff" * 5000, good[: len(good) // 2], glue()):
        with pytest.raises(
            InputError, match=f"not a {kind.upper()} model that onnxruntime can run"
        ) as refused:
            opened(kind, wrong)
        assert refused.value.where == f"{kind}.onnx"
        assert "keypoints" in refused.value.hint
        assert "docs/features.md" in refused.value.hint


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_with_other_descriptors_is_rejected_when_it_is_run(opened, kind):
    network = opened(kind, brightest(kind, table=TABLE[:, :64]))
    with pytest.raises(InputError, match="that onnxruntime can run"):
        features(kind, network, gray=dotted((64, 128)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_with_an_unknown_layer_is_rejected(opened, kind):
    with pytest.raises(InputError, match="that onnxruntime can run"):
        opened(kind, brightest(kind).replace(b"TopK", b"NopK"))


def test_a_batch_of_one_changes_nothing(opened):
    gray = dotted((64, 128))
    one, other = (
        features("aliked", opened("aliked", brightest("aliked", batch=b)), gray=gray) for b in (0, 1)
    )
    assert np.array_equal(one.xy, other.xy)
    assert np.array_equal(one.descriptors, other.descriptors)


@pytest.mark.parametrize("kind", KINDS)
def test_only_its_own_keypoints_are_described(opened, kind):
    gray = dotted((64, 128))
    network, made = opened(kind, brightest(kind)), EXTRACTORS[kind].make
    with pytest.raises(UsageError, match="only its own keypoints"):
        made(network).describe(gray, made(network).detect(gray, 5))
    with pytest.raises(MissingPart, match="expmap models list"):
        extract(gray, choose("verified", features=kind), keypoints=5)
    found = extract(gray, choose("verified", detector=kind, extractor="sift"), keypoints=5, network=network)
    assert np.abs(np.unique(found.xy, axis=0) - sorted(DOTS)).max() < 1e-3
