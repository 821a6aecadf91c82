"""Number plates: input and output of the network, and loading of a model made here."""

import numpy as np
import pytest

from tests.standin_models import lpd_yunet
from webapp.core.detections import LpdYuNet, decode_plates, plate_priors


def test_priors_are_those_of_the_published_network():
    at = plate_priors(320, 240)
    assert at.shape == (40 * 30 * 3 + 20 * 15 * 2 + 10 * 7 * 2 + 5 * 3 * 3, 3) == (4385, 3)
    assert at[:4].tolist() == [[4, 4, 10], [4, 4, 16], [4, 4, 24], [12, 4, 10]]
    assert at[3 * 40].tolist() == [4, 12, 10]  # the next row
    assert at[3600:3602].tolist() == [[8, 8, 32], [8, 8, 48]]
    assert at[-1].tolist() == [4.5 * 64, 2.5 * 64, 256]


def outputs(count):
    return (
        np.zeros((count, 14), np.float32),
        np.zeros((count, 2), np.float32),
        np.zeros((count, 1), np.float32),
    )


def test_corners_are_offsets_of_a_tenth_of_a_prior():
    loc, conf, iou = outputs(2)
    loc[1, [4, 5, 6, 7, 10, 11, 12, 13]] = [-5, -2, 5, -1, 6, 2, -4, 3]
    loc[1, [0, 1, 2, 3, 8, 9]] = 99  # box and middle are not used
    conf[1, 1], iou[1, 0] = 0.9, 0.6
    boxes, scores = decode_plates((loc, conf, iou), np.array([[0, 0, 10], [100, 50, 20.0]]))
    assert boxes == pytest.approx(np.array([[90, 46, 112, 56.0]]))
    assert scores == pytest.approx([0.54**0.5])


@pytest.mark.parametrize(
    ("conf_plate", "quality", "score"), [(0.81, 7.0, 0.9), (1.0, -3.0, None), (0.35, 1.0, None)]
)
def test_scores_are_clipped_and_the_doubtful_left_out(conf_plate, quality, score):
    loc, conf, iou = outputs(1)
    loc[0, [6, 10, 11, 13]] = 10
    conf[0], iou[0] = (0.0, conf_plate), quality
    scores = decode_plates((loc, conf, iou), np.array([[10, 10, 10.0]])).scores
    assert scores == pytest.approx([] if score is None else [score])


def test_of_plates_that_overlap_the_surest_is_kept():
    loc, conf, iou = outputs(3)
    loc[:, [6, 10, 11, 13]] = 10
    conf[:, 1], iou[:] = (0.7, 0.9, 0.8), 1
    boxes, scores = decode_plates((loc, conf, iou), np.array([[10, 10, 10], [11, 10, 10], [40, 10, 10.0]]))
    assert boxes[:, 0].tolist() == [11, 40]
    assert scores == pytest.approx(np.sqrt([0.9, 0.8]))


def test_a_white_spot_is_found_at_full_size_in_a_large_photo():
    photo = np.zeros((1000, 1300, 3), np.uint8)
    photo[604:620, 808:824] = 255
    found = LpdYuNet(lpd_yunet()).detect(photo)
    assert {one.kind for one in found} == {"plate"}
    assert found[0].score > 0.99
    for box in (one.box for one in found):
        middle = (box.x + box.width / 2) * 1300, (box.y + box.height / 2) * 1000
        assert middle == pytest.approx((816, 612), abs=16)
        assert 16 <= round(box.width * 1300) <= 48


def test_a_photo_without_plates_has_none():
    assert LpdYuNet(lpd_yunet()).detect(np.zeros((30, 20, 3), np.uint8)) == []
