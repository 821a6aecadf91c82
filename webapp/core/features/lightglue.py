"""LightGlue (Lindenberger et al. 2023): a network matches the keypoints of two photos, all at once.

It goes by descriptors and by how keypoints lie to each other, and finds more right matches than nearest
neighbours do, at a tenth of a second for 1000 keypoints each.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.modelfile import Expected, quietly, with_one_thread
from webapp.core.features.onnx import cut_after, with_products
from webapp.core.features.types import Features
from webapp.threads import Pool

_LEAST_SCORE = 0.1
"""Probability of a match, at least; what its authors take."""

_INPUTS = ("kpts0", "kpts1", "desc0", "desc1")

BEST = ("/net/TopK_output_0", "/net/TopK_output_1", "/net/TopK_1_output_1")
"""Layers of LighterGlue: logarithm of the likelihood and number of each keypoint's best partner, and of each
partner's best keypoint. Those after them pick the matches (NonZero), where OpenCV 5.0 now and then reads
memory that nobody has written, and crashes, when several threads are at work."""

EXPECTED = Expected("LightGlue", inputs=_INPUTS, outputs=("matches0", "mscores0"))


class PairMatcher(Protocol):
    """Matches the keypoints of two photos.

    Attributes
    ----------
    weights : str
        Stands for the content of the model file.
    """

    weights: str

    def match(self, query: Features, photo: Features) -> NDArray[np.int64]:
        """Match the keypoints of two photos; both have the features that the matcher is for.

        Returns
        -------
        (m, 2) int64
            Rows of `query` and of `photo`, each at most once; the surest match first.
        """


class LighterGlue:
    """LightGlue for XFeat, smaller (Potje et al. 2024); may be used by several threads.

    Parameters
    ----------
    model : bytes
        The published model file, known to be whole.
    """

    def __init__(self, model: bytes) -> None:
        self.weights = _hash(model)
        onnx = np.frombuffer(cut_after(model, BEST), np.uint8)
        self._nets = Pool(lambda: cv2.dnn.readNetFromONNX(onnx))

    def match(self, query: Features, photo: Features) -> NDArray[np.int64]:
        """Match the keypoints of two photos with XFeat's features: (m, 2) rows, the surest first."""
        if not (len(query) and len(photo)):
            return np.zeros((0, 2), np.int64)
        blobs = (_centred(query), _centred(photo), _units(query), _units(photo))
        with self._nets.lent() as net:
            for name, blob in zip(_INPUTS, blobs, strict=True):
                net.setInput(blob[None], name)
            likely, partner, back = (found.ravel() for found in net.forward(BEST))
        mutual = np.flatnonzero(back[partner] == np.arange(len(query)))
        return _surest(np.column_stack([mutual, partner[mutual]]), np.exp(likely[mutual]))


class LightGlue:
    """LightGlue for ALIKED as OpenCV runs it; may be used by several threads.

    Parameters
    ----------
    model : bytes
        Content of a file that the user supplies.
    path : str
        Where it is, for people.

    Raises
    ------
    InputError
        It is no such model.
    """

    def __init__(self, model: bytes, path: str) -> None:
        EXPECTED.check(model, path)
        with_one_thread()
        self.weights = _hash(model)
        self._path = path
        try:
            self._onnx = np.frombuffer(with_products(model), np.uint8)
        except ValueError as error:
            raise EXPECTED.refused(path) from error
        self._nets = Pool(self._opened)

    def match(self, query: Features, photo: Features) -> NDArray[np.int64]:
        """Match the keypoints of two photos with ALIKED's features: (m, 2) rows, the surest first.

        Raises
        ------
        InputError
            OpenCV cannot run the model.
        """
        if not (len(query) and len(photo)):
            return np.zeros((0, 2), np.int64)
        try:
            found = self._matched(query, photo)
        except cv2.error as error:
            raise EXPECTED.refused(self._path) from error
        pairs = np.array([(m.queryIdx, m.trainIdx) for m in found], np.int64).reshape(-1, 2)
        return _surest(pairs, 1.0 - np.array([m.distance for m in found], np.float32))

    def _matched(self, query: Features, photo: Features) -> Sequence[cv2.DMatch]:
        try:
            with self._nets.lent() as net:
                return _matches(net, query, photo)
        except cv2.error:
            # Where an Einsum is left, OpenCV 5.0 can do the numbers of keypoints of the first pair only.
            with self._nets.renewed() as net:
                return _matches(net, query, photo)

    def _opened(self) -> cv2.LightGlueMatcher:
        with quietly():
            return cv2.LightGlueMatcher.createFromMemory(self._onnx, _LEAST_SCORE)


def _matches(net: cv2.LightGlueMatcher, query: Features, photo: Features) -> Sequence[cv2.DMatch]:
    # OpenCV takes width and height for 2 each; in a square around the photo it keeps the photo's shape, as
    # the network has learned it.
    (here, side), (there, other) = _in_square(query), _in_square(photo)
    net.setPairInfo(here, there, (side, side), (other, other))
    found: Sequence[cv2.DMatch] = net.match(_units(query), _units(photo))
    return found


def _hash(model: bytes) -> str:
    return hashlib.sha256(model).hexdigest()[:16]


def _in_square(features: Features) -> tuple[NDArray[np.float32], int]:
    """Move keypoints as if the photo were in the middle of a square, and give its side."""
    side = max(features.photo_size)
    rims = np.array([(side - own) / 2.0 for own in features.photo_size], np.float32)
    return features.xy + rims, side


def _centred(features: Features) -> NDArray[np.float32]:
    """Measure keypoints from the middle of the photo, in halves of its longer side: (n, 2)."""
    xy, side = _in_square(features)
    return xy * np.float32(2.0 / side) - np.float32(1.0)


def _units(features: Features) -> NDArray[np.float32]:
    """Turn the bytes of descriptors into vectors of length 1: (n, d)."""
    values = features.descriptors.astype(np.float32) - np.float32(128.0)
    length = np.linalg.norm(values, axis=1, keepdims=True).astype(np.float32)
    units: NDArray[np.float32] = values / np.maximum(length, np.float32(1e-9))
    return units


def _surest(pairs: NDArray[np.int64], scores: NDArray[np.float32]) -> NDArray[np.int64]:
    """Keep the pairs with good scores, the surest first, and of each row the surest."""
    likely = np.flatnonzero(scores >= _LEAST_SCORE)
    ordered = pairs[likely[np.argsort(-scores[likely], kind="stable")]]
    for side in (0, 1):
        ordered = ordered[np.sort(np.unique(ordered[:, side], return_index=True)[1])]
    return ordered
