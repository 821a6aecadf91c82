"""Printed tags in photos, by OpenCV's detector of ArUco markers and AprilTags."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.mapmodel.control_points import TAG_FAMILIES

_DICTIONARIES = {
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "4x4_50": cv2.aruco.DICT_4X4_50,
    "5x5_100": cv2.aruco.DICT_5X5_100,
    "6x6_250": cv2.aruco.DICT_6X6_250,
}

_LEAST_SIDE_PX = 12.0
"""Shortest side of a tag that counts: smaller ones are read by chance, and their corners are inexact."""


_HALF_MODULE_PX, _SMOOTH_PX = (2, 8), 5
"""Least and most pixels of half a module in the pattern that is aligned with a photo; width of the blur."""

_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-5)
_MOST_MOVED_PX, _MOST_MOVED_SHARE = 1.5, 0.02
"""Farthest that aligning moves a corner: in pixels, and as a fraction of the tag's side, added."""


class SeenTag(NamedTuple):
    """A tag in a photo."""

    family: str
    number: int
    # (4, 2) float64. Outer corners of its black square, pixels with centres at whole numbers: top left, then
    # clockwise, as one sees the upright tag.
    corners: NDArray[np.float64]

    @property
    def side_px(self) -> float:
        """Shortest side."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, 0), axis=1).min())

    @property
    def middle(self) -> tuple[float, float]:
        """Pixel of its middle: where the diagonals cross, also in perspective."""
        a, b, c, d = np.column_stack([self.corners, np.ones(4)])
        crossing = np.cross(np.cross(a, c), np.cross(b, d))
        return float(crossing[0] / crossing[2]), float(crossing[1] / crossing[2])


def find_tags(gray: NDArray[np.uint8], families: Collection[str]) -> list[SeenTag]:
    """Find tags of some families in a grey photo, the largest first; one id may be there several times."""
    found = [tag for family in TAG_FAMILIES if family in families for tag in _of_family(gray, family)]
    large = [tag for tag in found if tag.side_px >= _LEAST_SIDE_PX]
    return sorted((_refined(gray, tag) for tag in large), key=lambda tag: -tag.side_px)


def _of_family(gray: NDArray[np.uint8], family: str) -> list[SeenTag]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, numbers, _ = cv2.aruco.ArucoDetector(_dictionary(family), parameters).detectMarkers(gray)
    if numbers is None:
        return []
    return [
        SeenTag(family, int(number), np.asarray(own, np.float64).reshape(4, 2))
        for number, own in zip(numbers.ravel(), corners, strict=True)
    ]


def _refined(gray: NDArray[np.uint8], tag: SeenTag) -> SeenTag:
    """Align the whole pattern of a tag with the photo (ECC): a corner alone is found too far inside.

    G. Evangelidis, E. Psarakis, "Parametric image alignment using enhanced correlation coefficient
    maximization", 2008.
    """
    black = np.pad(modules(tag.family, tag.number), 1)
    # as many pixels as in the photo, so that smoothing blurs both alike
    half = int(np.clip(round(tag.side_px / (len(black) - 2) / 2.0), *_HALF_MODULE_PX))
    pattern = np.kron(np.where(black, 0, 255), np.ones((2 * half, 2 * half))).astype(np.uint8)
    low, high = 2 * half - 0.5, len(pattern) - 2 * half - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    reach = 0.5 * tag.side_px
    first = np.maximum(np.floor(tag.corners.min(0) - reach), 0).astype(int)
    last = np.ceil(tag.corners.max(0) + reach).astype(int) + 1
    part = gray[first[1] : last[1], first[0] : last[0]]
    shrunk = min(1.0, 2.0 * half * (len(black) - 2) / tag.side_px)
    if shrunk < 1.0:
        part = cv2.resize(part, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA)
    seen = (tag.corners - first + 0.5) * shrunk - 0.5
    start = cv2.getPerspectiveTransform(square, seen.astype(np.float32))
    try:
        _, warp = cv2.findTransformECC(
            pattern, part, start.astype(np.float32), cv2.MOTION_HOMOGRAPHY, _STOP, None, _SMOOTH_PX
        )
    except cv2.error:  # it does not converge on a small or half hidden tag
        return tag
    corners = cv2.perspectiveTransform(square[None].astype(np.float64), warp.astype(np.float64))[0]
    corners = (corners + 0.5) / shrunk - 0.5 + first
    moved = float(np.abs(corners - tag.corners).max())
    is_near = moved < _MOST_MOVED_PX + _MOST_MOVED_SHARE * tag.side_px
    return tag._replace(corners=corners) if is_near else tag


def _dictionary(family: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_DICTIONARIES[family])


def modules(family: str, number: int) -> NDArray[np.bool_]:
    """Return the square modules of a tag with its black border, (n, n) bool, True where black."""
    side = int(_dictionary(family).markerSize) + 2
    return np.asarray(cv2.aruco.generateImageMarker(_dictionary(family), number, side) == 0)
