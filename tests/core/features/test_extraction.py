"""Features of photos: shapes, positions, scale, and matches across a known transformation."""

import itertools

import cv2
import numpy as np
import pytest

from webapp.core.features.extract import extract
from webapp.core.features.sift import root_sift
from webapp.core.features.table import DETECTORS, EXTRACTORS, FeatureChoice, choose
from webapp.core.retrieval.engines.bruteforce import BruteForce

PAIRS = [
    pair
    for pair in itertools.product(DETECTORS, EXTRACTORS)
    if FeatureChoice(*pair, "").model is None  # those with a model have separate tests
]


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """A textured (480, 640) picture: blobs and edges of many sizes."""
    rng = np.random.default_rng(5)
    picture = np.zeros((480, 640), np.float32)
    for size in (4, 8, 16, 32, 64):
        coarse = rng.normal(size=(480 // size + 1, 640 // size + 1)).astype(np.float32)
        picture += cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC) * size**0.5
    for _ in range(60):
        x, y = rng.integers(0, (600, 440))
        w, h = rng.integers(8, 60, 2)
        cv2.rectangle(picture, (int(x), int(y)), (int(x + w), int(y + h)), float(rng.normal() * 12), -1)
    return cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def of(detector: str, extractor: str, *, gray, keypoints=500, **more):
    return extract(gray, FeatureChoice(detector, extractor, ""), keypoints=keypoints, **more)


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_shapes_types_and_order(scene, detector, extractor):
    found = of(detector, extractor, gray=scene)
    n = len(found)
    assert 200 <= n <= 500
    assert found.xy.shape == (n, 2)
    assert found.xy.dtype == found.size.dtype == found.angle.dtype == np.float32
    assert found.size.shape == found.angle.shape == (n,)
    assert found.descriptors.shape == (n, EXTRACTORS[extractor].make().width)
    assert found.descriptors.dtype == np.uint8
    assert found.photo_size == (640, 480)
    assert (found.xy >= -0.5).all()
    assert (found.xy <= (639.5, 479.5)).all()
    assert (found.size > 0).all()
    assert ((found.angle >= 0) & (found.angle <= 360)).all()
    assert len(np.unique(found.descriptors, axis=0)) > 0.9 * n


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_the_same_photo_gives_the_same_bytes_with_any_number_of_threads(scene, detector, extractor):
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        one = of(detector, extractor, gray=scene)
        cv2.setNumThreads(2)
        two = of(detector, extractor, gray=scene)
    finally:
        cv2.setNumThreads(before)
    for name in ("xy", "size", "angle", "descriptors"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
@pytest.mark.parametrize("shape", [(480, 640), (1, 1), (3, 200), (800, 1), (62, 62), (70, 70)])
def test_a_photo_without_texture_has_no_features(detector, extractor, shape):
    found = of(detector, extractor, gray=np.full(shape, 127, np.uint8))
    assert len(found) == 0
    assert found.xy.shape == (0, 2)
    assert found.descriptors.shape == (0, EXTRACTORS[extractor].make().width)
    assert found.photo_size == shape[::-1]


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_never_more_keypoints_than_asked_for(scene, detector, extractor):
    assert len(of(detector, extractor, gray=scene, keypoints=37)) <= 37


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_places_are_those_of_the_full_photo_whatever_it_was_scaled_to(scene, detector, extractor):
    large = cv2.resize(scene, (1280, 960), interpolation=cv2.INTER_CUBIC)
    whole = of(detector, extractor, gray=large, keypoints=1500)
    half = cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA)
    scaled = of(detector, extractor, gray=half, keypoints=200, scale=0.5, photo_size=(1280, 960))
    assert scaled.photo_size == whole.photo_size == (1280, 960)
    apart = np.linalg.norm(scaled.xy[:, None] - whole.xy[None], axis=2)
    same_size = np.abs(np.log2(scaled.size[:, None] / whole.size[None])) < 0.3
    nearest = np.where(same_size, apart, np.inf).min(1)
    found_again = scaled.xy[nearest < 4.0], nearest < 4.0
    assert found_again[1].mean() > 0.5
    # The median offset per axis reveals a systematic shift, such as a forgotten half pixel.
    partner = whole.xy[np.where(same_size, apart, np.inf).argmin(1)][found_again[1]]
    assert np.abs(np.median(found_again[0] - partner, axis=0)).max() < 0.3
    # ORB's corners are whole pixels of an image up to 3.6 times smaller.
    assert np.median(nearest[found_again[1]]) < (1.0 if detector == "sift" else 1.5)


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_matches_follow_a_known_homography(scene, detector, extractor):
    turn = np.vstack([cv2.getRotationMatrix2D((320, 240), 15, 0.9), [0, 0, 1]])
    turn[2, :2] = 1e-4, -5e-5
    warped = cv2.warpPerspective(scene, turn, (640, 480))
    a, b = of(detector, extractor, gray=scene), of(detector, extractor, gray=warped)
    matcher = choose("vote", detector=detector, extractor=extractor).matcher
    norm = "l2" if matcher == "flann" else matcher
    there = BruteForce([b.descriptors], norm).search(a.descriptors, 1).row[:, 0]
    back = BruteForce([a.descriptors], norm).search(b.descriptors, 1).row[:, 0]
    mutual = np.flatnonzero(back[there] == np.arange(len(a)))
    moved = cv2.perspectiveTransform(a.xy[mutual][:, None].astype(np.float64), turn)[:, 0]
    right = np.linalg.norm(moved - b.xy[there[mutual]], axis=1) < 3.0
    assert right.sum() > 80
    # SURF localizes blobs less exactly, and other extractors describe the point, not the blob.
    assert right.mean() > (0.6 if detector == "surf" != extractor else 0.75)


def test_root_sift_is_the_hellinger_distance_in_steps():
    rng = np.random.default_rng(0)
    raw = np.floor(rng.gamma(0.5, 20.0, (50, 128))).clip(0, 255).astype(np.float32)
    quantised = root_sift(raw)
    exact = np.sqrt(raw / raw.sum(1, keepdims=True))
    assert quantised.dtype == np.uint8
    assert np.abs(quantised / 512.0 - exact).max() <= 0.5 / 512.0 + 1e-6
    assert np.allclose(np.linalg.norm(quantised / 512.0, axis=1), 1.0, atol=0.01)


def test_root_sift_of_a_single_peak_and_of_nothing_stays_in_a_byte():
    raw = np.zeros((2, 128), np.float32)
    raw[0, 7] = 255.0
    assert root_sift(raw)[0, 7] == 255
    assert not root_sift(raw)[1].any()


@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_a_dim_photo_shows_half_the_keypoints_of_a_bright_one_at_the_same_places(scene, detector, extractor):
    dim = np.clip(scene.astype(np.float32) * 0.1 + 4, 0, 255).astype(np.uint8)
    bright = of(detector, extractor, gray=scene)
    found = of(detector, extractor, gray=dim)
    assert len(found) >= 200  # of 250; a few are too close to the border to be described
    near = np.linalg.norm(found.xy[:, None] - bright.xy[None], axis=2).min(axis=1) < 2.0
    assert near.mean() > 0.4


@pytest.mark.parametrize("name", ["sift", "surf", "orb"])
def test_what_a_photo_shows_without_looking_for_faint_keypoints_is_kept(scene, name):
    dim = np.clip(scene.astype(np.float32) * 0.3 + 60, 0, 255).astype(np.uint8)
    usual = of(name, name, gray=dim, keypoints=10)
    for keypoints in range(100, 2000, 100):
        found = of(name, name, gray=dim, keypoints=keypoints)
        if len(found) == keypoints // 2:
            break
    assert len(found) == keypoints // 2  # so the search for faint keypoints was needed
    apart = np.linalg.norm(usual.xy[:, None] - found.xy[None], axis=2).min(axis=1)
    assert (apart < 0.01).mean() >= 0.8
