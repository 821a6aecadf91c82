"""SIFT (Lowe 2004), by default compared as RootSIFT (Arandjelović and Zisserman 2012)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.entry import FeatureEntry
from webapp.core.features.types import Described, Kind, detect_with_fallback_threshold, strongest

_BASE_SIGMA = 1.6
_LAYERS = 3
_PATCH_OVER_SIZE = 6.0
"""SIFT describes 4 bins of 3 sigma each: 6 times the size in OpenCV's keypoints."""

_CONTRAST = (0.04, 0.004)
"""Minimum contrast of a keypoint (grey values from 0 to 1, over all layers): Lowe's, and in dim photos."""

_ROOT_SCALE = 512.0
"""A RootSIFT component is at most 1 and rarely over 0.5: one byte stores it in steps of 1/512."""


class Sift:
    """Detector and extractor.

    Args:
        root: Describe as RootSIFT: the Euclidean distance then is the Hellinger distance of the histograms.
    """

    kind: Kind = "float"
    width = 128
    oriented = True

    def __init__(self, *, root: bool = True) -> None:
        self._root = root

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Detect the `keypoints` keypoints of highest contrast in an (h, w) uint8 image."""
        (found,) = detect_with_fallback_threshold(
            lambda most, contrast: (_sift(most, contrast).detect(gray, None),),
            keypoints,
            thresholds=_CONTRAST,
        )
        for keypoint in found:
            keypoint.size *= _PATCH_OVER_SIZE
        # OpenCV keeps all keypoints of equal contrast, which can be more than the number requested.
        return sorted(found, key=lambda k: -k.response)[:keypoints]

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe the `keypoints` keypoints of highest contrast; descriptors (n, 128) uint8."""
        found, raw = detect_with_fallback_threshold(
            lambda most, contrast: _sift(most, contrast).detectAndCompute(gray, None),
            keypoints,
            thresholds=_CONTRAST,
        )
        return strongest((found, self._as_bytes(raw)), keypoints)

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Describe another detector's keypoints; descriptors (n, 128) uint8."""
        if not keypoints:
            return (), self._as_bytes(None)
        described, raw = cv2.SIFT_create().compute(gray, [_in_sift_octave(k) for k in keypoints])
        return described, self._as_bytes(raw)

    def _as_bytes(self, raw: NDArray[np.float32] | None) -> NDArray[np.uint8]:
        if raw is None:
            return np.zeros((0, self.width), np.uint8)
        described: NDArray[np.uint8] = root_sift(raw) if self._root else raw.astype(np.uint8)
        return described


def _sift(keypoints: int, contrast: float) -> cv2.SIFT:
    return cv2.SIFT_create(keypoints, contrastThreshold=contrast)


def root_sift(raw: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Convert (n, 128) SIFT histograms to RootSIFT, in steps of 1/512, as (n, 128) uint8."""
    total = np.maximum(raw.sum(axis=1, keepdims=True), np.float32(1e-9))
    steps: NDArray[np.float32] = np.minimum(np.rint(np.sqrt(raw / total) * _ROOT_SCALE), 255.0)
    return steps.astype(np.uint8)


def _in_sift_octave(keypoint: cv2.KeyPoint) -> cv2.KeyPoint:
    """Assign another detector's keypoint the octave and layer that SIFT would describe its size in."""
    size = keypoint.size / _PATCH_OVER_SIZE
    level = float(np.log2(max(size, 1e-3) / (2.0 * _BASE_SIGMA)))
    octave = max(-1, int(np.floor(level)))
    layer = int(np.clip(round((level - octave) * _LAYERS), 1, _LAYERS))
    angle = keypoint.angle if keypoint.angle >= 0 else 0.0
    packed = (octave & 255) | (layer << 8)
    x, y = keypoint.pt
    return cv2.KeyPoint(x, y, size, angle, keypoint.response, packed)


ENTRIES = (
    FeatureEntry("sift", Sift, other_names=("rootsift",)),
    FeatureEntry("sift-plain", partial(Sift, root=False)),
)
