"""Sharp, spread frames of a video."""

import numpy as np
import pytest

from tests.video_clips import SIZE, pan
from webapp.core.keyframes import KeyframeChooser, small_gray


def chosen(positions, *, blurred=(), spread=0.25, fps=6.0):
    chooser = KeyframeChooser(spread=spread)
    frames = pan(positions, blurred=blurred)
    found = [chooser.offer(n, small_gray(frame), at_s=n / fps) for n, frame in enumerate(frames)]
    return [n for n in [*found, chooser.finish()] if n is not None]


def test_frames_are_spread_by_how_far_the_view_moves():
    positions = np.concatenate([np.arange(0, 400, 8), np.full(40, 400), np.arange(400, 1200, 16)])
    numbers = chosen(positions)
    steps = np.diff(positions[numbers]) / SIZE[0]
    assert len(numbers) >= 10
    assert ((steps > 0.15) & (steps < 0.4)).all()
    assert sum(50 <= n < 90 for n in numbers) <= 1, "a camera that stands still gives one photo"


def test_a_sharp_frame_is_preferred_to_its_blurred_neighbours():
    blurred = {n for n in range(120) if n % 4}
    numbers = chosen(np.arange(0, 1200, 10), blurred=blurred)
    assert len(numbers) >= 8
    assert not blurred & {*numbers}


def test_a_cut_to_another_view_is_noticed():
    positions = [0] * 20 + [900] * 20
    numbers = chosen(positions)
    assert {positions[n] for n in numbers} == {0, 900}


def test_a_view_without_corners_gives_a_photo_now_and_then():
    chooser = KeyframeChooser(spread=0.25)
    flat = np.full((240, 320), 90, np.uint8)
    found = [chooser.offer(n, flat, at_s=n / 6.0) for n in range(60)]
    assert 3 <= sum(n is not None for n in found) <= 6


@pytest.mark.parametrize("spread", [0.1, 0.5])
def test_a_larger_spread_gives_fewer_photos(spread):
    numbers = chosen(np.arange(0, 1200, 8), spread=spread)
    assert len(numbers) == pytest.approx(1200 / (spread * SIZE[0]), rel=0.5)
