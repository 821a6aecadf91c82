"""ALIKED (Zhao et al. 2023) as OpenCV runs it, with a model file that the user supplies."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.modelfile import Expected, quietly, with_one_thread
from webapp.core.features.points import WIDTH, PointFeatures, Points
from webapp.threads import Pool

EXPECTED = Expected("ALIKED", inputs=("image",), outputs=("keypoints", "descriptors", "scores"))

_SIZES = 2
"""So many sizes of photo are kept ready, each with a network of its own: landscape and portrait."""


class Aliked(PointFeatures):
    """Detector and extractor of ALIKED."""

    name = "ALIKED"


class AlikedNetwork:
    """The network with its weights; may be used by several threads.

    OpenCV opens the file itself, for each size of photo and each one that is looked at at the same time.

    Parameters
    ----------
    model : bytes
        Content of the file.
    path : str
        Where the file is.
    look : callable
        Called before OpenCV opens the file; raises where that is no longer the one that `model` was.

    Raises
    ------
    InputError
        It is no such model.
    """

    multiple = 32

    def __init__(self, model: bytes, path: str, *, look: Callable[[], object]) -> None:
        image = EXPECTED.check(model, path)["image"]
        if len(image) != 4:
            raise EXPECTED.refused(path)
        self.sides = (image[3], image[2])
        with_one_thread()
        self._path, self._look = path, look
        self._of_size = Pool(lambda: lru_cache(maxsize=_SIZES)(self._opened))

    def points(self, image: NDArray[np.uint8]) -> Points:
        """Find and describe keypoints in an (h, w, 3) uint8 image.

        Raises
        ------
        InputError
            OpenCV cannot run the model.
        MissingPart
            The file has changed.
        """
        height, width = image.shape[:2]
        try:
            with self._of_size.lent() as opened:
                found, descriptors = opened((width, height)).detectAndCompute(image, None)
        except cv2.error as error:
            raise EXPECTED.refused(self._path) from error
        if descriptors is None:
            return Points(
                np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, WIDTH), np.float32)
            )
        if descriptors.shape[1] != WIDTH:
            raise EXPECTED.refused(self._path)
        # The network says -1 for the first pixel's centre and 1 for the last one's; OpenCV takes them for
        # the rims of the image.
        onto_centres = np.array([(width - 1) / width, (height - 1) / height], np.float32)
        xy = np.array([k.pt for k in found], np.float32) * onto_centres
        return Points(xy, np.array([k.response for k in found], np.float32), descriptors)

    def _opened(self, size: tuple[int, int]) -> cv2.ALIKED:
        self._look()
        parameters = cv2.ALIKED.Params()
        parameters.inputSize = size
        with quietly():
            return cv2.ALIKED.create(self._path, parameters)
