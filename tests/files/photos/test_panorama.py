"""Level views of panoramas at the size used for features."""

import tracemalloc

import cv2
import numpy as np
import pytest

from webapp.core.boxes import BlurBox
from webapp.core.mapmodel.panorama import LevelView
from webapp.files.photos.panorama import read_level_view
from webapp.files.photos.photo import scaled_gray
from webapp.settings import PhotoLimits

LIMITS = PhotoLimits()


def blobs(wide):
    """Return a panorama with blobs of about ten degrees."""
    coarse = np.random.default_rng(3).integers(0, 256, (18, 36), dtype=np.uint8)
    coarse[:, -1] = coarse[:, 0]
    pixels = cv2.resize(coarse, (wide, wide // 2), interpolation=cv2.INTER_CUBIC)
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize("turn", [0, 180])
def test_a_small_view_is_the_whole_one_scaled_down(turn):
    view = LevelView(turn, (BlurBox(0.4, 0.6, 0.2, 0.1),))
    source = blobs(2000)
    whole = read_level_view(source, view, limits=LIMITS)
    small = read_level_view(source, view, limits=LIMITS, max_side=200)
    wanted = scaled_gray(whole.photo.pixels, 200)
    assert (small.photo.scale, small.photo.full_size) == (wanted.scale, wanted.full_size)
    assert small.photo.pixels.shape == small.used.shape == wanted.pixels.shape
    assert small.fov_deg == whole.fov_deg
    assert small.used.mean() == pytest.approx(whole.used.mean(), abs=0.01)
    away = cv2.erode(small.used.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) > 0
    off = np.abs(small.photo.pixels.astype(int) - wanted.pixels)[away]
    assert off.max() <= 4 and off.mean() < 0.5


def test_a_small_view_takes_little_memory():
    source = blobs(4000)
    tracemalloc.start()
    try:
        read_level_view(source, LevelView(60), limits=LIMITS, max_side=400)
        assert tracemalloc.get_traced_memory()[1] < 4 * 4000 * 2000, "bytes for each pixel"
    finally:
        tracemalloc.stop()
