"""Features of one photo, and the interface of extractors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Kind = Literal["float", "binary"]
"""How descriptors are compared: by a distance of real vectors, or by counting different bits."""

Engine = Literal["ivf", "vlad"]
"""How photos are searched: by codes of all descriptors, or by one signature per photo."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Keypoints and descriptors of one photo, the strongest first."""

    # (n, 2) float32. Pixels of the upright photo at full size; pixel centres have whole numbers, as in
    # OpenCV.
    xy: NDArray[np.float32]
    # (n,) float32. Diameter of the described neighbourhood, pixels of the photo at full size.
    size: NDArray[np.float32]
    # (n,) float32. Orientation in degrees, clockwise in the image; all 0 if the detector computes none.
    angle: NDArray[np.float32]
    # (n, d) uint8. Numbers 0 to 255 ("float" kind) or packed bits ("binary" kind).
    descriptors: NDArray[np.uint8]
    photo_size: tuple[int, int]  # Width and height of the upright photo
    # (d,) float32 or None. Global descriptor of the photo, of length 1, if there is a model.
    vector: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.xy)

    def subset(self, rows: NDArray[np.int64]) -> Features:
        return Features(
            xy=self.xy[rows],
            size=self.size[rows],
            angle=self.angle[rows],
            descriptors=self.descriptors[rows],
            photo_size=self.photo_size,
            vector=self.vector,
        )


LEAST_CONTRAST = 1.0
"""Standard deviation of the grey values (0 to 255) below which a photo has no texture for a network."""

ONE_SIZE = 32.0
"""Size of the described neighbourhood for networks with one scale only, pixels."""

Described = tuple[Sequence[cv2.KeyPoint], NDArray[np.uint8]]
"""n keypoints and their (n, width) uint8 descriptors."""


class Extractor(Protocol):
    """Detects keypoints, and describes its own or another extractor's."""

    kind: Kind
    width: int
    """Bytes of one descriptor."""
    oriented: bool
    """Whether keypoints have an orientation; otherwise their angle is always 0."""

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Detect at most `keypoints` keypoints in an (h, w) uint8 image, for another extractor.

        Their size is that of the patch that this extractor would describe.
        """

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe at most `keypoints` own keypoints in an (h, w) uint8 image, strongest first."""

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Describe another extractor's keypoints; those that cannot be described are left out."""


def features_from_keypoints(
    keypoints: Sequence[cv2.KeyPoint],
    descriptors: NDArray[np.uint8],
    *,
    scale: float,
    photo_size: tuple[int, int],
) -> Features:
    """Convert OpenCV's keypoints of a scaled image to features of the photo at full size.

    Args:
        descriptors: (n, d) uint8
        scale: Size of the image over size of the photo.
        photo_size: Width and height of the photo at full size.
    """
    table = np.array([(*k.pt, k.size, k.angle) for k in keypoints], np.float32).reshape(-1, 4)
    # OpenCV's origin is a pixel centre, but scaling acts on distances from the image's outer corner.
    xy = (table[:, :2] + 0.5) / scale - 0.5
    return Features(
        xy=xy.astype(np.float32),
        size=table[:, 2] / np.float32(scale),
        angle=table[:, 3],
        descriptors=np.ascontiguousarray(descriptors, np.uint8),
        photo_size=photo_size,
    )


def strongest(described: Described, keypoints: int) -> Described:
    """Keep the `keypoints` keypoints of highest response, in descending order."""
    found, descriptors = described
    order = sorted(range(len(found)), key=lambda i: -found[i].response)[:keypoints]
    return [found[i] for i in order], descriptors[order]


Found = TypeVar("Found", bound=tuple[Any, ...])
"""Output of a detector: columns with one entry per keypoint."""


def detect_with_fallback_threshold(
    detect: Callable[[int, float], Found], keypoints: int, *, thresholds: tuple[float, float]
) -> Found:
    """Detect keypoints, with a lower threshold if there are few, e.g. at night or in fog.

    The usual threshold suppresses noise in well-lit photos, which have enough keypoints; in a dim photo it
    would reject nearly all of them. There half the number is enough, because the rest is mostly noise.

    Args:
        detect: Takes a maximum number and a threshold, and returns the strongest keypoints above it.
        thresholds: The usual one and the lower one.

    Returns:
        As from `detect`; with the lower threshold at most half the number.
    """
    usual, lower = thresholds
    found = detect(keypoints, usual)
    few = keypoints // 2
    return found if len(found[0]) >= few else detect(few, lower)


def unit_as_bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Quantize (n, d) descriptors of length 1 to bytes, in steps of 1/254.

    A component is rarely over 0.5; larger ones are clipped.
    """
    steps: NDArray[np.float32] = np.clip(np.rint(128.0 + 254.0 * values), 0.0, 255.0)
    return steps.astype(np.uint8)
