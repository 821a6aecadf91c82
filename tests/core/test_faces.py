"""Faces become boxes for blurring; the network is a stand-in."""

import cv2
import numpy as np
import pytest

from tests.standin_models import yunet
from webapp.core.detections import YuNet


@pytest.fixture
def found(monkeypatch):
    """Return detections of the network, as rows of OpenCV."""
    rows = []

    class Network:
        @staticmethod
        def create(framework, model, config, size, *thresholds):
            assert (framework, model.tobytes(), size) == ("onnx", b"model", (640, 640))
            network = Network()
            network.size = size
            return network

        def detect(self, pixels):
            assert pixels.shape == (640, 640, 3)
            return 1, np.array(rows, np.float32) if rows else None

    monkeypatch.setattr(cv2, "FaceDetectorYN", Network)
    return rows


def row(x, y, width, height, score):
    return [x, y, width, height, *[0.0] * 10, score]


def test_boxes_are_shares_of_the_photo_with_the_surest_first(found):
    found += [row(20, 130, 40, 30, 0.7), row(0, 0, 100, 60, 0.9)]
    first, second = YuNet(b"model").detect(np.zeros((300, 200, 3), np.uint8))
    assert first.box == pytest.approx((0, 0, 0.5, 0.2))
    assert second.box == pytest.approx((0.1, 130 / 300, 0.2, 0.1))
    assert [(one.kind, round(one.score, 3)) for one in (first, second)] == [("face", 0.9), ("face", 0.7)]


def test_a_photo_without_faces_has_no_boxes(found):
    assert YuNet(b"model").detect(np.zeros((30, 20, 3), np.uint8)) == []


def test_small_faces_of_a_large_photo_are_seen_at_full_size(found, monkeypatch):
    photo = np.zeros((1500, 2000, 3), np.uint8)
    photo[1001:1021, 1501:1521] = 255

    def bright(self, pixels):
        y, x = np.nonzero(pixels[:, :, 0] > 250)
        if len(x) < 300:  # too small at this scale
            return 1, None
        return 1, np.array([row(x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1, 0.8)], np.float32)

    monkeypatch.setattr(cv2.FaceDetectorYN, "detect", bright)
    (face,) = YuNet(b"model").detect(photo)
    assert face.box == pytest.approx((1501 / 2000, 1001 / 1500, 0.01, 20 / 1500))


def test_a_model_like_the_published_one_is_run_by_opencv():
    photo = np.zeros((900, 700, 3), np.uint8)
    photo[604:620, 408:424] = 255
    found = YuNet(yunet()).detect(photo)
    assert found[0].score > 0.99
    for box in (one.box for one in found):
        middle = (box.x + box.width / 2) * 700, (box.y + box.height / 2) * 900
        assert middle == pytest.approx((416, 612), abs=16)
    assert YuNet(yunet()).detect(np.zeros((900, 700, 3), np.uint8)) == []
