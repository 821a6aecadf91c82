"""DISK (Tyszkiewicz et al. 2020) as OpenCV runs it, with a model file that the user supplies."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.modelfile import Expected, quietly, with_one_thread
from webapp.core.features.points import WIDTH, PointFeatures, Points
from webapp.threads import Pool

EXPECTED = Expected("DISK", inputs=("image",), outputs=("keypoints", "scores", "descriptors"))

_ALL = -1

_NOTHING_FOUND = "scoresBlob.rows == numFeatures"
"""What OpenCV 5.0 has asserted in vain where a network finds no keypoint."""


class Disk(PointFeatures):
    """Detector and extractor of DISK."""

    name = "DISK"


class DiskNetwork:
    """The network with its weights; may be used by several threads.

    Parameters
    ----------
    model : bytes
        Content of the file.
    path : str
        Where the file is, for people.

    Raises
    ------
    InputError
        It is no such model.
    """

    multiple = 16

    def __init__(self, model: bytes, path: str) -> None:
        image = EXPECTED.check(model, path)["image"]
        if len(image) != 4:
            raise EXPECTED.refused(path)
        self.sides = (image[3], image[2])
        with_one_thread()
        self._path = path
        self._onnx = np.frombuffer(model, np.uint8)
        self._nets = Pool(self._opened)

    def points(self, image: NDArray[np.uint8]) -> Points:
        """Find and describe keypoints in an (h, w, 3) uint8 image.

        Raises
        ------
        InputError
            OpenCV cannot run the model.
        """
        try:
            with self._nets.lent() as net:
                return self._points(net, image)
        except cv2.error as error:
            if _NOTHING_FOUND not in str(error):
                raise EXPECTED.refused(self._path) from error
            # A broken network can fail so with any image. One that works finds something in noise.
            noise = np.random.default_rng(0).integers(0, 256, image.shape, dtype=np.uint8)
            try:
                with self._nets.renewed() as net:
                    self._points(net, noise)
            except cv2.error:
                raise EXPECTED.refused(self._path) from error
            return Points(*(np.zeros(shape, np.float32) for shape in ((0, 2), 0, (0, WIDTH))))

    def _points(self, net: cv2.DISK, image: NDArray[np.uint8]) -> Points:
        net.setImageSize(image.shape[1::-1])
        found, descriptors = net.detectAndCompute(image, None)
        if descriptors is None:
            descriptors = np.zeros((0, WIDTH), np.float32)
        elif descriptors.shape[1] != WIDTH:
            raise EXPECTED.refused(self._path)
        xy = np.array([k.pt for k in found], np.float32).reshape(-1, 2)
        return Points(xy, np.array([k.response for k in found], np.float32), descriptors)

    def _opened(self) -> cv2.DISK:
        with quietly():
            return cv2.DISK.createFromMemory(self._onnx, _ALL, 0.0)
