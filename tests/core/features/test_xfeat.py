"""XFeat: shapes of the output with random weights, quality with the real ones."""

import cv2
import numpy as np
import pytest

from tests.standin_models import xfeat
from webapp.core.features.extract import extract
from webapp.core.features.table import choose
from webapp.core.features.xfeat import XFeat, XFeatNetwork
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.errors import MissingPart
from webapp.threads import in_threads

CHOICE = choose("verified", features="xfeat")


@pytest.fixture(scope="module")
def invented() -> XFeatNetwork:
    """A network with the same layers and random weights."""
    return XFeatNetwork(xfeat())


@pytest.fixture(scope="module")
def published(shared_models) -> bytes:
    """The file with real weights."""
    return (shared_models / "xfeat_800x576.onnx").read_bytes()


@pytest.mark.parametrize("shape", [(480, 640), (333, 517), (20, 25), (32, 64)])
def test_any_size_of_photo_gives_keypoints_inside_it(invented, shape):
    gray = np.random.default_rng(2).integers(0, 256, shape, dtype=np.uint8)
    found = extract(gray, CHOICE, keypoints=300, network=invented)
    again = extract(gray, CHOICE, keypoints=300, network=invented)
    assert (found.descriptors == again.descriptors).all()
    n = len(found)
    assert 0 < n <= 300
    assert found.descriptors.shape == (n, 64)
    assert found.photo_size == shape[::-1]
    assert (found.xy > -1.0).all()
    assert (found.xy < shape[::-1]).all()
    assert not found.angle.any()
    length = np.linalg.norm(found.descriptors.astype(float) - 128.0, axis=1)
    assert np.abs(length / 254.0 - 1.0).max() < 0.05
    enlarged = min(max(640 / max(shape), 1.0), 4.0)
    assert n == len(np.unique(np.rint((found.xy + 0.5) * enlarged - 0.5), axis=0))


@pytest.mark.parametrize("shape", [(480, 640), (1, 1), (3, 200)])
def test_without_texture_there_is_nothing(invented, shape):
    found = extract(np.full(shape, 127, np.uint8), CHOICE, keypoints=100, network=invented)
    assert found.xy.shape == (0, 2)
    assert found.descriptors.shape == (0, 64)


def test_light_and_contrast_do_not_matter(invented):
    gray = np.random.default_rng(3).integers(0, 100, (96, 640), dtype=np.uint8)
    dark, bright = (extract(g, CHOICE, keypoints=80, network=invented) for g in (gray, 2 * gray + 40))
    assert np.abs(dark.xy - bright.xy).max() < 0.01
    assert np.abs(dark.descriptors.astype(int) - bright.descriptors).max() <= 1


def test_each_thread_and_each_order_of_sizes_gives_the_same(invented):
    rng = np.random.default_rng(5)
    photos = [rng.integers(0, 256, shape, dtype=np.uint8) for shape in [(96, 128), (160, 64), (96, 128)] * 3]
    alone = [extract(p, CHOICE, keypoints=50, network=invented) for p in photos]
    together = in_threads(lambda p: extract(p, CHOICE, keypoints=50, network=invented), photos)
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.xy, other.xy)
        assert np.array_equal(one.descriptors, other.descriptors)


@pytest.mark.parametrize(("detector", "extractor"), [("sift", "xfeat"), ("xfeat", "sift"), ("xfeat", "orb")])
def test_it_goes_with_other_detectors_and_extractors(invented, detector, extractor):
    gray = cv2.blur(np.random.default_rng(6).integers(0, 256, (240, 320), dtype=np.uint8), (5, 5))
    choice = choose("verified", detector=detector, extractor=extractor)
    found = extract(gray, choice, keypoints=100, network=invented)
    assert len(found) > 20
    assert len(np.unique(found.descriptors, axis=0)) >= len(np.unique(found.xy, axis=0))


def test_without_weights_it_says_how_to_get_them():
    with pytest.raises(MissingPart, match="expmap models fetch"):
        extract(np.zeros((64, 64), np.uint8), CHOICE, keypoints=10)


def test_any_size_computes_what_the_published_network_does_for_its_own(published):
    image = np.random.default_rng(7).normal(size=(576, 800)).astype(np.float32)
    maps = XFeatNetwork(published).maps(image)
    net = cv2.dnn.readNetFromONNX(np.frombuffer(published, np.uint8))
    net.setInput(image[None, None])
    for output in net.forward(list(net.getUnconnectedOutLayersNames())):
        as_it_is = {65: maps.logits, 64: maps.descriptors}.get(output.shape[3])
        if as_it_is is None:
            assert np.abs(maps.reliability - output[0, 0]).max() < 1e-4
        else:
            assert np.abs(as_it_is.transpose(1, 2, 0) - output[0]).max() < 1e-4


def _mutual(a, b):
    """Find the nearest row of b for each row of a, and the rows of a that are mutual nearest neighbours."""
    there = BruteForce([b.descriptors], "l2").search(a.descriptors, 1).row[:, 0]
    back = BruteForce([a.descriptors], "l2").search(b.descriptors, 1).row[:, 0]
    return there, np.flatnonzero(back[there] == np.arange(len(a)))


def test_a_small_photo_is_seen_as_well_as_one_of_640_pixels(published, shared_data):
    network = XFeatNetwork(published)
    photo = next((shared_data / "gardens_point" / "day_left").iterdir())
    whole = cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE)
    small = cv2.resize(whole, (320, 180), interpolation=cv2.INTER_AREA)
    a, b = (extract(g, CHOICE, keypoints=500, network=network) for g in (small, whole))
    assert len(a) > 400
    there, mutual = _mutual(a, b)
    expected = (b.xy[there[mutual]] + 0.5) * 320 / whole.shape[1] - 0.5
    off = np.linalg.norm(a.xy[mutual] - expected, axis=1)
    assert (off < 1.0).sum() > 50


def test_matches_follow_a_known_homography(published, shared_data):
    network = XFeatNetwork(published)
    photo = next((shared_data / "getty" / "photos").iterdir())
    gray = cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE)
    height, width = gray.shape
    turn = np.vstack([cv2.getRotationMatrix2D((width / 2, height / 2), 8, 0.9), [0, 0, 1]])
    warped = cv2.warpPerspective(gray, turn, (width, height))
    a, b = (extract(g, CHOICE, keypoints=1000, network=network) for g in (gray, warped))
    there, mutual = _mutual(a, b)
    moved = cv2.perspectiveTransform(a.xy[mutual][:, None].astype(np.float64), turn)[:, 0]
    off = np.linalg.norm(moved - b.xy[there[mutual]], axis=1)
    assert (off < 3.0).sum() > 300
    assert np.median(off[off < 3.0]) < 0.8
    assert XFeat.oriented is False
