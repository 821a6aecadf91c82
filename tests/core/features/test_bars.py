"""Bars around photos are found, and what merely looks uniform is left."""

import numpy as np
import pytest

from webapp.core.features.bars import Inside, inside_bars


@pytest.fixture
def scene():
    return np.random.default_rng(0).integers(0, 256, (90, 120)).astype(np.uint8)


def framed(scene, *, top=0, bottom=0, left=0, right=0, colour=0):
    return np.pad(scene, ((top, bottom), (left, right)), constant_values=colour)


@pytest.mark.parametrize("colour", [0, 40, 255])
def test_bars_of_a_screenshot_are_found(scene, colour):
    shot = framed(scene, top=60, bottom=70, colour=colour)
    shot[10:16, 5:15] = 128  # the clock
    assert inside_bars(shot) == Inside(0, 60, 120, 150)
    assert inside_bars(framed(scene, left=30, right=20, colour=colour)) == Inside(30, 0, 150, 90)
    both = framed(scene, top=20, bottom=20, left=9, right=9, colour=colour)
    assert inside_bars(both) == Inside(9, 20, 129, 110)


def test_a_photo_without_bars_stays_whole(scene):
    assert inside_bars(scene) == Inside(0, 0, 120, 90)
    assert inside_bars(np.zeros((90, 120), np.uint8)) == Inside(0, 0, 120, 90)
    assert inside_bars(framed(scene[:10], top=80, colour=0)) == Inside(0, 0, 120, 90)  # hardly anything left


def test_sky_and_darkness_are_not_bars(scene):
    sky = scene.copy()
    for x in range(120):
        sky[: 30 + x // 3, x] = 255  # ends in a skyline
    assert inside_bars(sky) == Inside(0, 0, 120, 90)
    dark = (scene * np.linspace(0.0, 1.0, 90)[:, None] ** 2).astype(np.uint8)
    assert inside_bars(dark) == Inside(0, 0, 120, 90)
