"""LightGlue (Lindenberger et al., "LightGlue: Local feature matching at light speed", 2023).

A network matches all keypoints of two photos jointly, by their descriptors and positions. It finds more
correct matches than nearest-neighbour search, in about a tenth of a second for 1000 keypoints per photo.
"""

from __future__ import annotations

import hashlib
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.network import Interface, Network
from webapp.core.features.types import Features

_MIN_SCORE = 0.1
"""Minimum probability of a match; the authors' value."""

_INPUTS = ("kpts0", "kpts1", "desc0", "desc1")

LIGHTGLUE = Interface("LightGlue", _INPUTS, ("matches0", "mscores0"))
"""For ALIKED, from a file that the user supplies."""

LIGHTERGLUE = Interface("LighterGlue", _INPUTS, ("matches", "scores"))
"""For XFeat, a smaller network (Potje et al. 2024), from the published file."""


class PairMatcher(Protocol):
    """Matches the keypoints of two photos."""

    weights: str  # Identifies the content of the model file

    def match(self, query: Features, photo: Features) -> NDArray[np.int64]:
        """Match the keypoints of two photos, which have the features that the matcher is for.

        Returns:
            (m, 2) int64: Rows of `query` and of `photo`, each at most once; the most probable match first.
        """


class LightGlue:
    """LightGlue for one kind of features; threads may share it.

    Args:
        interface: `LIGHTGLUE` or `LIGHTERGLUE`.
    """

    def __init__(self, model: bytes, interface: Interface, *, file: str) -> None:
        self.weights = hashlib.sha256(model).hexdigest()[:16]
        self._network = Network(model, interface, file=file)

    def match(self, query: Features, photo: Features) -> NDArray[np.int64]:
        """Match the keypoints of two photos: (m, 2) rows, the most probable match first."""
        if not (len(query) and len(photo)):
            return np.zeros((0, 2), np.int64)
        inputs = (_centred(query), _centred(photo), _unit_length(query), _unit_length(photo))
        pairs, scores = self._network.run(**{k: v[None] for k, v in zip(_INPUTS, inputs, strict=True)})
        if pairs.shape != (scores.size, 2):
            raise self._network.error()
        return _most_probable(pairs.astype(np.int64), scores.ravel())


def _centred(features: Features) -> NDArray[np.float32]:
    """Convert keypoints to coordinates from the centre of the photo, in halves of its longer side: (n, 2)."""
    size = np.array(features.photo_size, np.float32)
    xy: NDArray[np.float32] = (features.xy - size / 2) * (2.0 / size.max())
    return xy


def _unit_length(features: Features) -> NDArray[np.float32]:
    """Convert the bytes of descriptors to vectors of length 1: (n, d)."""
    values = features.descriptors.astype(np.float32) - np.float32(128.0)
    length = np.linalg.norm(values, axis=1, keepdims=True).astype(np.float32)
    units: NDArray[np.float32] = values / np.maximum(length, np.float32(1e-9))
    return units


def _most_probable(pairs: NDArray[np.int64], scores: NDArray[np.float32]) -> NDArray[np.int64]:
    """Keep pairs above the minimum score, the best first, and only the best pair of each row."""
    likely = np.flatnonzero(scores >= _MIN_SCORE)
    ordered = pairs[likely[np.argsort(-scores[likely], kind="stable")]]
    for side in (0, 1):
        ordered = ordered[np.sort(np.unique(ordered[:, side], return_index=True)[1])]
    return ordered
