"""Finds faces in photos, so that they can be blurred.

YuNet: Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", Machine Intelligence Research 20, 2023.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.detections import Detection, WindowDetections, detect_in_windows, never

_SIZE = (640, 640)
"""Input size of the published model; it finds faces of about 10 to 300 pixels."""

_OVERLAP_PX = 128
_LEAST_SCORE = 0.6
_OVERLAP = 0.3
"""Of two faces that overlap by more, only the better one is kept."""

_MOST = 200


class YuNet:
    """YuNet by OpenCV.

    Args:
        model: ONNX, as published in the OpenCV Zoo.
    """

    def __init__(self, model: bytes) -> None:
        self._model = np.frombuffer(model, np.uint8)

    def detect(self, pixels: NDArray[np.uint8], *, check: Callable[[], None] = never) -> list[Detection]:
        """Find faces."""
        # not shared: a network of OpenCV serves one thread at a time; this one loads in milliseconds
        network = cv2.FaceDetectorYN.create(
            "onnx", self._model, np.zeros(0, np.uint8), _SIZE, _LEAST_SCORE, _OVERLAP, _MOST
        )

        def look(part: NDArray[np.uint8]) -> WindowDetections:
            found = network.detect(part)[1]
            rows = np.zeros((0, 15)) if found is None else np.asarray(found, np.float64)
            return WindowDetections(np.hstack([rows[:, :2], rows[:, :2] + rows[:, 2:4]]), rows[:, 14])

        return detect_in_windows(pixels, look, kind="face", size=_SIZE, overlap=_OVERLAP_PX, check=check)
