"""Networks that detect and describe keypoints in one pass, at a single scale and without orientation.

ALIKED (Zhao et al., "ALIKED: A lighter keypoint and descriptor extraction network", 2023) and DISK
(Tyszkiewicz et al., "DISK: Learning local features with policy gradient", 2020), with model files that the
user supplies.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.entry import FeatureEntry, ModelEntry, supplied_file
from webapp.core.features.lightglue import LIGHTGLUE, LightGlue
from webapp.core.features.network import Interface, Network
from webapp.core.features.types import LEAST_CONTRAST, ONE_SIZE, Described, Kind, strongest, unit_as_bytes
from webapp.errors import MissingPart, UsageError


class Points(NamedTuple):
    xy: NDArray[np.float32]  # (n, 2) float32. Pixels; pixel centres have whole numbers.
    score: NDArray[np.float32]  # (n,) float32
    descriptors: NDArray[np.float32]  # (n, width) float32


class KeypointNetwork:
    """The network with its weights; threads may share it.

    Args:
        model: Content of an ONNX file with the input `image` (1, 3, h, w), RGB from 0 to 1, and the outputs
            `keypoints` (n, 2), `scores` (n,) and `descriptors` (n, width), with or without a batch of one.

    Attributes:
        name: Of the network, for messages.
        width: Dimension of a descriptor.
        sides: (int or None, int or None). Width and height of its input images; None if any multiple of
            `multiple` is possible.
    """

    name = ""
    width = 128
    multiple = 1

    def __init__(self, model: bytes, file: str) -> None:
        interface = Interface(self.name, ("image",), ("keypoints", "scores", "descriptors"))
        self._network = Network(model, interface, file=file)
        shape = self._network.inputs["image"]
        if len(shape) != 4:
            raise self._network.error()
        self.sides = (shape[3], shape[2])

    def points(self, image: NDArray[np.uint8]) -> Points:
        """Detect and describe keypoints in an (h, w) uint8 image of a size that the network takes."""
        gray = image.astype(np.float32) / np.float32(255.0)
        xy, score, descriptors = self._network.run(image=np.broadcast_to(gray, (1, 3, *gray.shape)))
        n = score.size
        if xy.size != 2 * n or descriptors.size != self.width * n:
            raise self._network.error()
        pixels = self._in_pixels(xy.reshape(n, 2).astype(np.float32), image.shape)
        return Points(pixels, score.reshape(n), descriptors.reshape(n, self.width))

    def _in_pixels(self, xy: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
        return xy


class AlikedNetwork(KeypointNetwork):
    """ALIKED. Its coordinates are -1 at the centre of the first pixel and 1 at that of the last one."""

    name = "ALIKED"
    multiple = 32

    def _in_pixels(self, xy: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
        last = np.array([shape[1] - 1, shape[0] - 1], np.float32)
        pixels: NDArray[np.float32] = (xy + np.float32(1.0)) * (last / np.float32(2.0))
        return pixels


class DiskNetwork(KeypointNetwork):
    """DISK. Its coordinates are pixels."""

    name = "DISK"
    multiple = 16


class NetworkFeatures:
    """Detector and extractor around a network. It describes only its own keypoints.

    Args:
        network: Required for detection.
    """

    kind: Kind = "float"
    oriented = False

    def __init__(self, of: type[KeypointNetwork], network: KeypointNetwork | None = None) -> None:
        self.name, self.width = of.name, of.width
        self._network = network

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Detect the `keypoints` best keypoints of an (h, w) uint8 image."""
        return self.detect_and_describe(gray, keypoints)[0]

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe the `keypoints` best keypoints; descriptors (n, width) uint8."""
        if self._network is None:
            raise MissingPart(f"the model for {self.name} is not installed", hint="see expmap models list")
        if cv2.meanStdDev(gray)[1].item() < LEAST_CONTRAST:
            return (), np.zeros((0, self.width), np.uint8)
        image, shown = _letterbox(gray, self._network)
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
        """Reject keypoints of another detector."""
        raise UsageError(f"{self.name} describes only its own keypoints", where="--extractor")


def _letterbox(
    gray: NDArray[np.uint8], network: KeypointNetwork
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Resize and pad an (h, w) photo to a size that the network takes, undistorted.

    Returns:
        (height, width) uint8: The photo in the upper left corner; its last pixels are repeated, to avoid an
            edge at its border.
        (2,) float64: Width and height of the photo in the image.
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
    return whole, shown


def _entry(
    name: str, network: type[KeypointNetwork], *, source: str, pair_matcher: ModelEntry | None = None
) -> FeatureEntry:
    model = ModelEntry(name, (supplied_file(f"{name}.onnx", source),), network)
    make = partial(NetworkFeatures, network)
    return FeatureEntry(name, make, model=model, pair_matcher=pair_matcher, own_keypoints=True)


_ALIKED_LIGHTGLUE = ModelEntry(
    "aliked-lightglue",
    (supplied_file("aliked_lightglue.onnx", "LightGlue of github.com/cvg/LightGlue for ALIKED"),),
    lambda model, file: LightGlue(model, LIGHTGLUE, file=file),
)

ENTRIES = (
    _entry(
        "aliked",
        AlikedNetwork,
        source="ALIKED of github.com/Shiaoming/ALIKED",
        pair_matcher=_ALIKED_LIGHTGLUE,
    ),
    _entry("disk", DiskNetwork, source="DISK of github.com/cvlab-epfl/disk"),
)
