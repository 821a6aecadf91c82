"""Features of a network that finds and describes keypoints in one pass: of one scale, without orientation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import LEAST_CONTRAST, ONE_SIZE, Described, Kind, strongest, unit_as_bytes
from webapp.errors import MissingPart, UsageError

WIDTH = 128
"""Numbers of a descriptor."""


class Points(NamedTuple):
    """What a network found in an image.

    Attributes
    ----------
    xy : (n, 2) float32
        Pixels; pixel centres have whole numbers.
    score : (n,) float32
    descriptors : (n, 128) float32
    """

    xy: NDArray[np.float32]
    score: NDArray[np.float32]
    descriptors: NDArray[np.float32]


class PointNetwork(Protocol):
    """A network that finds and describes keypoints."""

    sides: tuple[int | None, int | None]
    """Width and height of the images that it takes; None where any multiple of `multiple` will do."""
    multiple: int

    def points(self, image: NDArray[np.uint8]) -> Points:
        """Find and describe keypoints in an (h, w, 3) uint8 image of a size that it takes."""


class PointFeatures:
    """Detector and extractor around a network. It describes no keypoints but its own.

    Parameters
    ----------
    network : PointNetwork, optional
        Without it nothing can be found.
    """

    kind: Kind = "float"
    width = WIDTH
    oriented = False
    name = ""
    """Of the features."""

    def __init__(self, network: PointNetwork | None = None) -> None:
        self._network = network

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Find the `keypoints` best keypoints of an (h, w) uint8 image."""
        return self.detect_and_describe(gray, keypoints)[0]

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Find and describe the `keypoints` best keypoints; descriptors (n, 128) uint8."""
        if self._network is None:
            raise MissingPart(f"the model of {self.name} is not here", hint="see expmap models list")
        if cv2.meanStdDev(gray)[1].item() < LEAST_CONTRAST:
            return (), np.zeros((0, self.width), np.uint8)
        image, shown = _placed(gray, self._network)
        points = self._network.points(image)
        inside = ((points.xy > -0.5) & (points.xy < shown - 0.5)).all(axis=1)
        height, width = gray.shape
        xy = (points.xy[inside] + 0.5) * (np.array([width, height]) / shown) - 0.5
        length = np.linalg.norm(points.descriptors[inside], axis=1, keepdims=True)
        units = points.descriptors[inside] / np.maximum(length, np.float32(1e-9))
        scored = zip(xy.tolist(), points.score[inside].tolist(), strict=True)
        found = [cv2.KeyPoint(x, y, ONE_SIZE, 0.0, s) for (x, y), s in scored]
        return strongest((found, unit_as_bytes(units)), keypoints)

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Refuse another detector's keypoints."""
        raise UsageError(f"{self.name} describes no keypoints but its own", where="--extractor")


def _placed(gray: NDArray[np.uint8], network: PointNetwork) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Bring an (h, w) photo to a size that the network takes, undistorted.

    Returns
    -------
    (height, width, 3) uint8
        The photo in the upper left corner; its last pixels are repeated, which makes no edge where it ends.
    (2,) float64
        Width and height of the photo in it.
    """
    size = np.array(gray.shape[::-1], np.float64)
    fixed = [(side, own) for side, own in zip(network.sides, size, strict=True) if side]
    shown = np.maximum(np.rint(size * min((side / own for side, own in fixed), default=1.0)), 1.0)
    width, height = (int(side) for side in shown)
    if (height, width) != gray.shape:
        how = cv2.INTER_AREA if width < gray.shape[1] else cv2.INTER_LINEAR
        gray = cv2.resize(gray, (width, height), interpolation=how)
    right = (network.sides[0] or width + -width % network.multiple) - width
    below = (network.sides[1] or height + -height % network.multiple) - height
    whole = cv2.copyMakeBorder(gray, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return cv2.cvtColor(whole, cv2.COLOR_GRAY2BGR), shown
