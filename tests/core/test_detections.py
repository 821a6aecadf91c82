"""Windows over a photo, and merging of their detections."""

import numpy as np
import pytest

from webapp.core.boxes import BlurBox
from webapp.core.detections import (
    Detection,
    WindowDetections,
    boxes_to_blur,
    detect_in_windows,
    is_hidden,
    merge_duplicates,
    non_maximum_suppression,
    spans,
    windows,
)
from webapp.errors import Cancelled


@pytest.mark.parametrize("length", [1, 240, 241, 384, 385, 1000, 4001])
def test_spans_cover_a_side_and_overlap_enough(length):
    starts = spans(length, size=240, overlap=96)
    ends = [start + 240 for start in starts]
    assert starts[0] == 0
    assert ends[-1] == max(length, 240)
    assert all(end - start >= 96 for end, start in zip(ends, starts[1:], strict=False))


def test_a_photo_is_seen_at_full_size_and_halved_until_it_fits():
    pixels = np.full((300, 500, 3), 7, np.uint8)
    parts = list(windows(pixels, size=(320, 240), overlap=96))
    assert [window for window, _ in parts] == [(0, 0, 0), (0, 180, 0), (0, 0, 60), (0, 180, 60), (1, 0, 0)]
    assert {part.shape for _, part in parts} == {(240, 320, 3)}
    last = parts[-1][1]
    assert (last[:150, :250] == 7).all()
    assert not last[150:].any() and not last[:, 250:].any()


def test_boxes_of_windows_become_shares_of_the_photo():
    photo = np.zeros((300, 500, 3), np.uint8)
    photo[200:220, 300:340] = 255

    def look(part):
        y, x = np.nonzero(part[:, :, 0] > 250)
        boxes = (
            np.array([[x.min(), y.min(), x.max() + 1, y.max() + 1]], float) if len(x) else np.zeros((0, 4))
        )
        return WindowDetections(boxes, np.full(len(boxes), 0.8))

    (found,) = detect_in_windows(photo, look, kind="plate", size=(320, 240), overlap=96)
    assert found.box == pytest.approx((0.6, 200 / 300, 0.08, 20 / 300))
    assert (found.kind, found.score) == ("plate", 0.8)


def test_a_search_is_stopped_between_windows():
    seen = []

    def look(part):
        seen.append(1)
        return WindowDetections(np.zeros((0, 4)), np.zeros(0))

    def check():
        if len(seen) == 2:
            raise Cancelled("stopped")

    photo = np.zeros((300, 500, 3), np.uint8)
    with pytest.raises(Cancelled):
        detect_in_windows(photo, look, kind="plate", size=(320, 240), overlap=96, check=check)
    assert len(seen) == 2


def test_hidden_is_what_is_mostly_covered_by_one_box_or_by_several():
    face = BlurBox(0.4, 0.4, 0.2, 0.2)
    left, right = BlurBox(0.3, 0.3, 0.2, 0.4), BlurBox(0.5, 0.3, 0.2, 0.4)
    assert not is_hidden(face, [])
    assert not is_hidden(face, [BlurBox(0.49, 0.49, 0.02, 0.02)])  # only the middle
    assert not is_hidden(face, [left])
    assert is_hidden(face, [left, right])
    assert is_hidden(face, [BlurBox(0.4, 0.4, 0.2, 0.16)])


def test_the_best_of_overlapping_boxes_are_chosen():
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [5, 0, 15, 10], [30, 0, 40, 10]], float)
    assert non_maximum_suppression(boxes, np.array([0.5, 0.9, 0.7, 0.6]), overlap=0.5) == [1, 2, 3]
    assert non_maximum_suppression(boxes, np.array([0.5, 0.9, 0.7, 0.6]), overlap=0.3) == [1, 3]
    assert non_maximum_suppression(np.zeros((0, 4)), np.zeros(0), overlap=0.3) == []


def test_parts_of_one_thing_are_joined_and_neighbours_are_not():
    part = Detection("face", BlurBox(0.1, 0.1, 0.1, 0.2), 0.9)
    whole = Detection("face", BlurBox(0.1, 0.1, 0.2, 0.2), 0.7)
    neighbour = Detection("face", BlurBox(0.29, 0.1, 0.2, 0.2), 0.8)
    plate = Detection("plate", BlurBox(0.1, 0.1, 0.1, 0.2), 0.6)
    joined = merge_duplicates([whole, part, neighbour, plate])
    assert [(one.kind, one.score) for one in joined] == [("face", 0.9), ("face", 0.8), ("plate", 0.6)]
    assert joined[0].box == pytest.approx(whole.box)


def test_what_is_to_be_blurred_is_larger_and_inside_and_not_there_yet():
    boxes = [BlurBox(0.4, 0.4, 0.2, 0.1), BlurBox(0.9, -0.02, 0.2, 0.1), BlurBox(0.1, 0.1, 0.1, 0.1)]
    faces = [Detection("face", box, 0.9) for box in boxes]
    middle, corner = (one.box for one in boxes_to_blur(faces, blurred=[BlurBox(0.05, 0.05, 0.2, 0.2)]))
    assert middle == pytest.approx((0.36, 0.38, 0.28, 0.14))
    assert corner.inside
    assert corner.x + corner.width == pytest.approx(1)
    assert corner.y == 0
    assert boxes_to_blur([Detection("face", BlurBox(1.3, 0.1, 0.1, 0.1), 0.9)], blurred=[]) == []
    (plate,) = boxes_to_blur([Detection("plate", boxes[0], 0.9)], blurred=[])
    assert plate.box == pytest.approx((0.38, 0.39, 0.24, 0.12))
