"""Photos with nothing to recognise, and dim ones that still show something."""

import cv2
import numpy as np
import pytest

from webapp.core.features.blank import FEWEST_KEYPOINTS, why_blank
from webapp.core.features.extract import extract
from webapp.core.features.table import choose

SIFT = choose("verified", features="sift")


def photo(*, light=1.0, noise=0.0):
    """Draw shapes, in less light and with noise."""
    rng = np.random.default_rng(1)
    scene = np.full((240, 320), 90, np.uint8)
    for _ in range(80):
        x, y = (int(v) for v in rng.uniform((0, 0), (320, 240)))
        cv2.circle(scene, (x, y), int(rng.integers(3, 25)), int(rng.integers(0, 255)), -1)
    return np.clip(scene * light + rng.normal(0.0, noise, scene.shape), 0, 255).astype(np.uint8)


def seen(gray):
    return why_blank(gray, extract(gray, SIFT, keypoints=500))


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_black_and_flat_photos_are_blank_also_with_noise(noise):
    assert seen(photo(light=0.0, noise=noise)) == "the photo is nearly uniform"
    assert seen(photo(light=0.0, noise=noise) + np.uint8(200)) == "the photo is nearly uniform"


def test_too_few_keypoints_are_counted():
    gray = np.full((240, 320), 60, np.uint8)
    gray[:120] = 180
    assert seen(gray) == "no keypoints"
    features = extract(photo(), SIFT, keypoints=500)
    assert why_blank(photo(), features.subset(np.arange(1))) == "only 1 keypoint"
    assert why_blank(photo(), features.subset(np.arange(FEWEST_KEYPOINTS - 1))) == "only 7 keypoints"
    assert why_blank(photo(), features.subset(np.arange(FEWEST_KEYPOINTS))) == ""


@pytest.mark.parametrize("light", [1.0, 1 / 10, 1 / 40])
def test_a_dim_photo_of_something_is_not_blank(light):
    assert seen(photo(light=light, noise=1.0)) == ""
