"""Chooses frames of a video that are sharp and spread: each shows a good part that the last one did not.

Corners are followed from the last chosen frame (J. Shi, C. Tomasi, "Good features to track", 1994; pyramidal
Lucas-Kanade). When they have moved far enough, the sharpest of the next frames is chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
T = TypeVar("T")

SMALL_PX = 320
"""Width at which frames are compared."""

_CORNERS, _LEAST = 200, 12
_KEPT = 0.4
"""Share of corners below which the view is another one."""

_EARLY, _LATE = 0.7, 1.3
"""Frames that have moved by these multiples of the wanted distance are candidates."""

_FIRST = 0.2
"""The first frame is the sharpest until this multiple."""

_FLAT_S = 2.0
"""Seconds after which a view without corners counts as another one."""

_BLURRED, _BLURRED_S = 0.5, 1.0
"""A frame less sharp than the one before by this factor is skipped, for at most so many seconds."""

_FLOW = {"winSize": (21, 21), "maxLevel": 4}


@dataclass(slots=True, eq=False)
class _Candidate(Generic[T]):
    frame: T
    gray: Gray
    sharpness: float
    at_s: float


class KeyframeChooser(Generic[T]):
    """Takes frames in order of time; `T` is whatever the caller keeps of a chosen one."""

    def __init__(self, *, spread: float) -> None:
        """Set how far the view moves between two chosen frames, as a fraction of their width."""
        self._spread = spread
        self._best: _Candidate[T] | None = None
        self._anchor: NDArray[np.float32] | None = None  # (n, 2): the corners in the last chosen frame
        self._now = np.zeros((0, 2), np.float32)  # Where they are
        self._before: Gray | None = None
        self._chosen_s: float | None = None
        self._sharp, self._followed_s = 0.0, -math.inf  # Of the last frame that was followed
        self._count = 0  # Corners of the last chosen frame

    def offer(self, frame: T, gray: Gray, *, at_s: float) -> T | None:
        """Take the next frame, with its gray picture of `SMALL_PX` width; return one that is chosen now."""
        if self._before is None:
            self._follow_from(gray)
        sharp = sharpness(gray)
        if sharp < _BLURRED * self._sharp and at_s - self._followed_s < _BLURRED_S:
            return None  # corners are lost in it, which is no other view
        self._sharp, self._followed_s = sharp, at_s
        moved = self._moved(gray, at_s)
        self._before = gray
        first = self._chosen_s is None
        early, late = (0.0, _FIRST) if first else (_EARLY, _LATE)
        if moved < early * self._spread:
            return None
        candidate = _Candidate(frame, gray, sharp, at_s)
        if moved <= late * self._spread:
            if self._best is None or candidate.sharpness > self._best.sharpness:
                self._best = candidate
            return None
        chosen, self._best = self._best or candidate, None
        self._begin_at(chosen, gray)
        return chosen.frame

    def finish(self) -> T | None:
        """Return the last chosen frame, if there is one more."""
        chosen, self._best = self._best, None
        return chosen.frame if chosen is not None else None

    def _begin_at(self, chosen: _Candidate[T], gray: Gray) -> None:
        self._chosen_s = chosen.at_s
        self._follow_from(chosen.gray)
        if gray is not chosen.gray:
            self._follow_to(gray)

    def _follow_from(self, gray: Gray) -> None:
        corners = cv2.goodFeaturesToTrack(gray, _CORNERS, 0.01, 6)
        found = np.zeros((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
        self._anchor, self._now, self._before, self._count = found, found, gray, len(found)

    def _follow_to(self, gray: Gray) -> None:
        assert self._before is not None
        assert self._anchor is not None
        if not len(self._now):
            return
        there, found, _ = cv2.calcOpticalFlowPyrLK(self._before, gray, self._now, None, **_FLOW)
        back, again, _ = cv2.calcOpticalFlowPyrLK(gray, self._before, there, None, **_FLOW)
        returns = np.linalg.norm(back - self._now, axis=1) < 1.5
        inside = ((there >= 0) & (there < [gray.shape[1], gray.shape[0]])).all(1)
        kept = (found.ravel() == 1) & (again.ravel() == 1) & returns & inside
        self._anchor, self._now, self._before = self._anchor[kept], there[kept], gray

    def _moved(self, gray: Gray, at_s: float) -> float:
        """How far the view has moved since the last chosen frame; infinite if it is another one."""
        if self._count < _LEAST:
            since = at_s - (self._chosen_s or 0.0)
            return math.inf if since >= _FLAT_S else 0.0
        self._follow_to(gray)
        if len(self._now) < max(_KEPT * self._count, _LEAST / 2):
            return math.inf
        assert self._anchor is not None
        pixels = float(np.median(np.linalg.norm(self._now - self._anchor, axis=1)))
        return pixels / float(gray.shape[1])


def small_gray(pixels: NDArray[np.uint8]) -> Gray:
    """Make the gray picture (h, SMALL_PX) by which a frame is compared, from BGR pixels (h, w, 3)."""
    height, width = pixels.shape[:2]
    size = (SMALL_PX, max(1, round(height * SMALL_PX / width)))
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def sharpness(gray: Gray) -> float:
    """Variance of the Laplacian: comparable only between pictures of one scene."""
    return float(cv2.Laplacian(gray, cv2.CV_32F).var())
