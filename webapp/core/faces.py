"""Finds faces in photos, so that they can be blurred.

YuNet: Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", Machine Intelligence Research 20, 2023.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.blur import BlurBox

_LEAST_SCORE = 0.6
_OVERLAP = 0.3
"""Of two faces that overlap by more, the better one counts."""

_MOST = 200
_MARGIN = 0.2
"""Of a face on each side: hair and chin identify, too."""


class FaceDetector(Protocol):
    """Finds faces."""

    def detect(self, pixels: NDArray[np.uint8]) -> list[BlurBox]:
        """Find the faces of a photo of (h, w, 3) uint8, blue, green, red; tight boxes, the surest first."""


class YuNet:
    """YuNet by OpenCV.

    Parameters
    ----------
    model : bytes
        ONNX, as published in the OpenCV Zoo.
    """

    def __init__(self, model: bytes) -> None:
        self._model = np.frombuffer(model, np.uint8)

    def detect(self, pixels: NDArray[np.uint8]) -> list[BlurBox]:
        """Find faces."""
        height, width = pixels.shape[:2]
        # a network of OpenCV serves one thread at a time, and this one is read in milliseconds
        network = cv2.FaceDetectorYN.create(
            "onnx", self._model, np.zeros(0, np.uint8), (width, height), _LEAST_SCORE, _OVERLAP, _MOST
        )
        found = network.detect(pixels)[1]
        rows = np.zeros((0, 15)) if found is None else np.asarray(found, np.float64)
        size = np.array([width, height, width, height], np.float64)
        return [BlurBox(*(row[:4] / size).tolist()) for row in rows[np.argsort(-rows[:, 14], kind="stable")]]


def blur_boxes(faces: Iterable[BlurBox], *, blurred: Iterable[BlurBox]) -> list[BlurBox]:
    """Make boxes that hide faces, with a margin; faces that are blurred already are left out."""
    there = list(blurred)
    return [box for face in faces if (box := _with_margin(face)).inside and not _hidden(face, there)]


def _with_margin(face: BlurBox) -> BlurBox:
    left, right = (np.clip(face.x + share * face.width, 0, 1) for share in (-_MARGIN, 1 + _MARGIN))
    top, bottom = (np.clip(face.y + share * face.height, 0, 1) for share in (-_MARGIN, 1 + _MARGIN))
    return BlurBox(float(left), float(top), float(right - left), float(bottom - top))


def _hidden(face: BlurBox, blurred: Iterable[BlurBox]) -> bool:
    x, y = face.x + face.width / 2, face.y + face.height / 2
    return any(b.x <= x <= b.x + b.width and b.y <= y <= b.y + b.height for b in blurred)
