"""Finds number plates in photos, so that they can be blurred.

LPD-YuNet of the OpenCV Zoo: YuNet with the four corners of a plate in place of a face's landmarks. It was
trained on Chinese plates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.detections import (
    Detection,
    WindowDetections,
    detect_in_windows,
    never,
    non_maximum_suppression,
)

SIZE = (320, 240)
"""Width and height of the images that the published file takes."""

_LAYERS = ((8, (10, 16, 24)), (16, (32, 48)), (32, (64, 96)), (64, (128, 192, 256)))
"""Stride of each layer, and the sizes of its priors, in pixels."""

_VARIANCE = 0.1
"""Unit of corner offsets, over a prior's size; the other variance, 0.2, is of widths, which are not used."""

_CORNERS = (4, 6, 10, 12)
"""Columns of the corners' x; 0 to 3 are a box, and 8 and 9 its centre."""

_OUTPUTS = ("loc", "conf", "iou")
_LEAST_SCORE = 0.6
_OVERLAP = 0.3
"""Of two plates that overlap by more, only the better one is kept."""

_OVERLAP_PX = 96


def priors(width: int, height: int) -> NDArray[np.float64]:
    """List the prior boxes that a network for images of this size refines.

    Returns:
        (n, 3) float64: Centre and side in pixels; by layer, row, column and size.
    """
    shape = np.array([(height + 1) // 2 // 2, (width + 1) // 2 // 2])
    found = []
    for stride, sides in _LAYERS:
        shape = shape // 2
        rows, columns = shape.tolist()
        y, x, side = np.meshgrid(np.arange(rows), np.arange(columns), np.array(sides), indexing="ij")
        found.append(np.stack([(x + 0.5) * stride, (y + 0.5) * stride, side], axis=-1).reshape(-1, 3))
    return np.concatenate(found).astype(np.float64)


def decode(outputs: Sequence[NDArray[np.float32]], at: NDArray[np.float64]) -> WindowDetections:
    """Convert the network's outputs to boxes around the corners of plates.

    Args:
        outputs: sequence of (n, 14), (n, 2) and (n, 1) float32. `loc`, `conf`, `iou`: for each prior,
            position of the plate, score of there being one and of its box.
        at: (n, 3) float64. As from `priors`.

    Returns:
        Those above the minimum score, each plate once, the best first.
    """
    loc, conf, iou = outputs
    scores = np.sqrt(conf[:, 1].astype(np.float64) * np.clip(iou[:, 0].astype(np.float64), 0, 1))
    sure = np.flatnonzero(scores >= _LEAST_SCORE)
    x, y = (
        at[sure, axis, None] + loc[sure][:, [c + axis for c in _CORNERS]] * _VARIANCE * at[sure, 2:3]
        for axis in (0, 1)
    )
    boxes = np.stack([x.min(1), y.min(1), x.max(1), y.max(1)], axis=1).astype(np.float64)
    best = non_maximum_suppression(boxes, scores[sure], overlap=_OVERLAP)
    return WindowDetections(boxes[best], scores[sure][best])


class LpdYuNet:
    """LPD-YuNet by OpenCV.

    Args:
        model: ONNX, as published in the OpenCV Zoo.
    """

    def __init__(self, model: bytes) -> None:
        self._model = np.frombuffer(model, np.uint8)
        self._priors = priors(*SIZE)

    def detect(self, pixels: NDArray[np.uint8], *, check: Callable[[], None] = never) -> list[Detection]:
        """Find number plates."""
        network = cv2.dnn.readNetFromONNX(self._model)  # not shared between threads, as for faces

        def look(part: NDArray[np.uint8]) -> WindowDetections:
            network.setInput(cv2.dnn.blobFromImage(part))
            outputs = [np.asarray(array, np.float32) for array in network.forward(_OUTPUTS)]
            return decode(outputs, self._priors)

        return detect_in_windows(pixels, look, kind="plate", size=SIZE, overlap=_OVERLAP_PX, check=check)
