"""ORB (Rublee et al. 2011): oriented FAST corners with rotated binary tests."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.entry import FeatureEntry
from webapp.core.features.types import Described, Kind, strongest

_SCALE_FACTOR = 1.2
_LEVELS = 8
_PATCH = 31
_DIFFERENCE, _WEAK_DIFFERENCE = 20, 3
"""FAST threshold, grey values: the usual one, and that in dim photos."""

_BORDER = 31
"""Width of the border without corners, pixels."""


class Orb:
    """Detector and extractor.

    Args:
        points_per_test: 2 or 4. 2: each bit compares two points, for Hamming distance. 4: each pair of bits
            is the index of the brightest of four points, for Hamming2, which counts pairs of bits.
    """

    kind: Kind = "binary"
    width = 32
    oriented = True

    def __init__(self, *, points_per_test: int = 2) -> None:
        self._points_per_test = points_per_test

    def _orb(self, keypoints: int, difference: int = _DIFFERENCE) -> cv2.ORB:
        return cv2.ORB_create(
            keypoints,
            _SCALE_FACTOR,
            _LEVELS,
            edgeThreshold=_BORDER,
            WTA_K=self._points_per_test,
            patchSize=_PATCH,
            fastThreshold=difference,
        )

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Find at most `keypoints` corners in an (h, w) uint8 image, the strongest first."""
        if _too_small(gray):
            return ()
        found = self._with_weak(gray, self._orb(keypoints).detect(gray, None), keypoints)
        return sorted(found, key=lambda k: -k.response)[:keypoints]

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe the `keypoints` strongest corners; descriptors (n, 32) uint8."""
        if _too_small(gray):
            return (), self._or_none(None)
        orb = self._orb(keypoints)
        found, bits = orb.detectAndCompute(gray, None)
        more = self._with_weak(gray, found, keypoints)
        if len(more) > len(found):
            found, bits = orb.compute(gray, more)
        return strongest((found, self._or_none(bits)), keypoints)

    def _with_weak(
        self, gray: NDArray[np.uint8], found: Sequence[cv2.KeyPoint], keypoints: int
    ) -> Sequence[cv2.KeyPoint]:
        """Add weak corners if fewer than half of the number wanted are detected.

        The others are kept: ORB limits the number per level, so a lower threshold alone can drop some.
        """
        lacking = keypoints // 2 - len(found)
        if lacking <= 0:
            return found
        weak = self._orb(keypoints, _WEAK_DIFFERENCE).detect(gray, None)
        known = {(k.pt, k.octave) for k in found}
        others = (k for k in sorted(weak, key=lambda k: -k.response) if (k.pt, k.octave) not in known)
        return [*found, *islice(others, lacking)]

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Describe another detector's keypoints; descriptors (n, 32) uint8.

        Keypoints too near to the border for the tests are left out.
        """
        if not keypoints or _too_small(gray):
            return (), self._or_none(None)
        described, bits = self._orb(len(keypoints)).compute(gray, [_in_orb_level(k) for k in keypoints])
        return described, self._or_none(bits)

    def _or_none(self, bits: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        return np.zeros((0, self.width), np.uint8) if bits is None else bits


def _too_small(gray: NDArray[np.uint8]) -> bool:
    """Check whether an image is all border; OpenCV fails on some of these."""
    height, width = gray.shape
    return bool(min(height, width) <= 2 * _BORDER)


def _in_orb_level(keypoint: cv2.KeyPoint) -> cv2.KeyPoint:
    """Assign another detector's keypoint the pyramid level whose patch has its size."""
    level = round(float(np.log(max(keypoint.size, 1.0) / _PATCH) / np.log(_SCALE_FACTOR)))
    angle = keypoint.angle if keypoint.angle >= 0 else 0.0
    octave = int(np.clip(level, 0, _LEVELS - 1))
    x, y = keypoint.pt
    return cv2.KeyPoint(x, y, keypoint.size, angle, keypoint.response, octave)


ENTRIES = (
    FeatureEntry("orb", Orb),
    FeatureEntry("orb-wta4", partial(Orb, points_per_test=4), pairs_of_bits=True),
)
