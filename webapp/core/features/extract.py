"""Extraction of features from a grey photo."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.table import EXTRACTORS, FeatureChoice
from webapp.core.features.types import Extractor, Features, features_from_keypoints

_UPSAMPLED_SIDE_PX, _MAX_FACTOR = 640, 4.0
"""XFeat has one scale and cells of 8 pixels: its keypoints are too few and too coarse in small photos. These
are enlarged until the longer side has this many pixels, but at most by this factor. Large photos that were
scaled down are not enlarged."""


def extract(
    gray: NDArray[np.uint8],
    choice: FeatureChoice,
    *,
    keypoints: int,
    scale: float = 1.0,
    photo_size: tuple[int, int] | None = None,
    network: object | None = None,
) -> Features:
    """Detect and describe keypoints.

    Args:
        gray: (h, w) uint8. The upright photo, scaled by `scale`.
        keypoints: Maximum number; the strongest are kept.
        scale: Size of `gray` over size of the photo.
        photo_size: Width and height of the photo at full size; by default of `gray`.
        network: Network of `choice.model`, opened, if that is not None.

    Returns:
        In pixels of the photo at full size. Empty for a photo without texture.

    Raises:
        MissingPart: The network is required but not given.
        InputError: The network is from a file supplied by the user, and onnxruntime cannot run it.
    """
    size = photo_size or (gray.shape[1], gray.shape[0])
    if choice.model is not None and EXTRACTORS[choice.model].enlarges_small and scale >= 1.0:
        gray, enlarged = _upsample_small(gray)
        scale *= enlarged
    extractor = _made(choice.extractor, network)
    if choice.detector == EXTRACTORS[choice.extractor].detector:
        found, descriptors = extractor.detect_and_describe(gray, keypoints)
    else:
        detected = _made(choice.detector, network).detect(gray, keypoints)
        found, descriptors = extractor.describe(gray, detected)
    return features_from_keypoints(found, descriptors, scale=scale, photo_size=size)


def _upsample_small(gray: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """Upsample a small photo; returns it and the factor."""
    factor = min(_UPSAMPLED_SIDE_PX / max(gray.shape), _MAX_FACTOR)
    if factor <= 1.0:
        return gray, 1.0
    large = cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large, np.uint8), factor


def _made(name: str, network: object | None) -> Extractor:
    entry = EXTRACTORS[name]
    return entry.make() if entry.model is None or network is None else entry.make(network)
