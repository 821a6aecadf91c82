"""Faces become boxes that hide them; the network itself is a stand-in."""

import cv2
import numpy as np
import pytest

from webapp.core.blur import BlurBox
from webapp.core.faces import YuNet, blur_boxes


@pytest.fixture
def found(monkeypatch):
    """What the network finds: rows of OpenCV."""
    rows = []

    class Network:
        @staticmethod
        def create(framework, model, config, size, *thresholds):
            assert (framework, model.tobytes()) == ("onnx", b"model")
            network = Network()
            network.size = size
            return network

        def detect(self, pixels):
            assert self.size == (pixels.shape[1], pixels.shape[0])
            return 1, np.array(rows, np.float32) if rows else None

    monkeypatch.setattr(cv2, "FaceDetectorYN", Network)
    return rows


def row(x, y, width, height, score):
    return [x, y, width, height, *[0.0] * 10, score]


def test_boxes_are_shares_of_the_photo_with_the_surest_first(found):
    found += [row(20, 30, 40, 30, 0.7), row(0, 0, 100, 60, 0.9)]
    boxes = YuNet(b"model").detect(np.zeros((300, 200, 3), np.uint8))
    assert boxes[0] == pytest.approx((0, 0, 0.5, 0.2))
    assert boxes[1] == pytest.approx((0.1, 0.1, 0.2, 0.1))


def test_a_photo_without_faces_has_no_boxes(found):
    assert YuNet(b"model").detect(np.zeros((30, 20, 3), np.uint8)) == []


def test_what_hides_a_face_is_larger_and_inside_and_not_there_yet():
    faces = [BlurBox(0.4, 0.4, 0.2, 0.1), BlurBox(0.9, -0.02, 0.2, 0.1), BlurBox(0.1, 0.1, 0.1, 0.1)]
    middle, corner = blur_boxes(faces, blurred=[BlurBox(0.05, 0.05, 0.2, 0.2)])
    assert middle == pytest.approx((0.36, 0.38, 0.28, 0.14))
    assert corner.inside
    assert corner.x + corner.width == pytest.approx(1)
    assert corner.y == 0
    assert blur_boxes([BlurBox(1.3, 0.1, 0.1, 0.1)], blurred=[]) == []
