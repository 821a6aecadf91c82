"""From a grey photo to its features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.table import DETECTORS, EXTRACTORS, FeatureChoice
from webapp.core.features.types import Detector, Extractor, Features, features_from_keypoints
from webapp.core.features.xfeat import XFeat
from webapp.core.features.xfeatnet import XFeatNetwork


def extract(
    gray: NDArray[np.uint8],
    choice: FeatureChoice,
    *,
    keypoints: int,
    scale: float = 1.0,
    photo_size: tuple[int, int] | None = None,
    network: XFeatNetwork | None = None,
) -> Features:
    """Detect and describe keypoints.

    Parameters
    ----------
    gray : (h, w) uint8
        The upright photo, scaled by `scale`.
    choice : FeatureChoice
    keypoints : int
        At most so many, the strongest.
    scale : float
        Size of `gray` over size of the photo.
    photo_size : (int, int), optional
        Width and height of the photo at full size; of `gray` when it was not scaled.
    network : XFeatNetwork, optional
        Needed where `choice.model` says so.

    Returns
    -------
    Features
        In pixels of the photo at full size. Empty for a photo without texture.

    Raises
    ------
    MissingPart
        The network is needed and not given.
    """
    learned = XFeat(network)
    extractor: Extractor = learned if choice.extractor == "xfeat" else EXTRACTORS[choice.extractor]()
    if choice.detector == choice.extractor.split("-")[0]:
        found, descriptors = extractor.detect_and_describe(gray, keypoints)
    else:
        detector: Detector = learned if choice.detector == "xfeat" else DETECTORS[choice.detector]()
        found, descriptors = extractor.describe(gray, detector.detect(gray, keypoints))
    size = photo_size or (gray.shape[1], gray.shape[0])
    return features_from_keypoints(found, descriptors, scale=scale, photo_size=size)
