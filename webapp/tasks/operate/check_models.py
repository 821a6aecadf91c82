"""Tries installed networks on a pair of pictures that this module draws, one a known warp of the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.extract import extract
from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import EXTRACTORS, PAIR_MATCHERS, choose
from webapp.core.features.types import Features
from webapp.errors import InputError, MissingPart, StorageError
from webapp.files.localize.models import (
    MODELS,
    NETWORKS,
    checked_weights,
    find_weights,
    global_descriptor,
    installed,
    network,
    open_model,
)
from webapp.settings import Settings

_SIZE = (640, 480)
_SHAPES, _KEYPOINTS = 350, 1000
_CLOSE_PX = 3.0
"""Matches farther than this from the known warp are wrong."""


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """How a model did on the pair of pictures."""

    model: str
    # `matches`, `inliers`: Matches, and those that agree with the known warp; None for a network that matches
    # nothing.
    matches: int | None
    inliers: int | None
    milliseconds: float | None  # For one picture, or for matchers the pair; None if it cannot be used
    problem: str = ""  # Why it cannot be used


def check_models(settings: Settings) -> Iterator[ModelCheck]:
    """Try each installed model once for warming up, and once more for the time."""
    pair = picture_pair()
    for model in MODELS:
        if installed(model, settings.models) is None:
            continue
        try:
            yield _check(model, pair, settings)
        except (InputError, MissingPart, StorageError) as error:
            yield ModelCheck(model, None, None, None, problem=str(error))


class PicturePair(NamedTuple):
    """A picture and its warp."""

    # `first`, `second`: (h, w) uint8
    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    warp: NDArray[np.float64]  # (3, 3) float64. From pixels of the first to those of the second.


def picture_pair() -> PicturePair:
    """Draw a picture of many shapes, and warp it."""
    rng = np.random.default_rng(0)
    width, height = _SIZE
    picture = np.full((height, width), 128, np.uint8)
    for _ in range(_SHAPES):
        centre = rng.uniform((0, 0), _SIZE)
        corners = centre + rng.normal(0.0, rng.uniform(6.0, 30.0), (rng.integers(3, 6), 2))
        cv2.fillPoly(picture, [corners.astype(np.int32)], int(rng.integers(0, 256)))
    first = np.asarray(cv2.GaussianBlur(picture, None, 0.8), np.uint8)
    turned = cv2.getRotationMatrix2D((width / 2, height / 2), 4.0, 1.05)
    warp = np.vstack([turned, [2e-5, 1e-5, 1.0]]).astype(np.float64)
    second = np.asarray(cv2.warpPerspective(first, warp, _SIZE), np.uint8)
    return PicturePair(first, second, warp)


def _check(model: str, pair: PicturePair, settings: Settings) -> ModelCheck:
    chosen = settings.models
    if model in NETWORKS:
        path, file = find_weights(model, chosen)
        detector = NETWORKS[model](checked_weights(model, path, sha256=file.sha256))
        _, spent = _timed(lambda: detector.detect(cv2.cvtColor(pair.first, cv2.COLOR_GRAY2RGB)))
        return ModelCheck(model, None, None, spent)
    if model == "global":
        described = global_descriptor(chosen)
        assert described is not None, "it is installed"
        shape = (described.height, described.width, 3)
        _, spent = _timed(lambda: described.describe(np.resize(pair.first, shape)))
        return ModelCheck(model, None, None, spent)
    features = next((name for name, matcher in PAIR_MATCHERS.items() if matcher == model), model)
    found, spent = _timed(lambda: [_extract(p, features, settings) for p in pair[:2]])
    spent /= 2
    if model in EXTRACTORS:
        pairs = _nearest(*found)
    else:
        matcher = cast(PairMatcher, open_model(model, chosen))
        pairs, spent = _timed(lambda: matcher.match(*found))
    return ModelCheck(model, len(pairs), _inliers(*found, pairs=pairs, warp=pair.warp), spent)


def _extract(picture: NDArray[np.uint8], features: str, settings: Settings) -> Features:
    choice = choose("verified", features=features)
    opened = network(choice.model, settings.models)
    return extract(picture, choice, keypoints=_KEYPOINTS, network=opened)


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    work()
    started = time.perf_counter()
    done = work()
    return done, (time.perf_counter() - started) * 1e3


def _nearest(first: Features, second: Features) -> NDArray[np.int64]:
    """Match descriptors that are nearest neighbours of each other: (m, 2) rows."""
    if not (len(first) and len(second)):
        return np.zeros((0, 2), np.int64)
    one, other = (f.descriptors.astype(np.float32) for f in (first, second))
    found = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(one, other)
    return np.array([(m.queryIdx, m.trainIdx) for m in found], np.int64).reshape(-1, 2)


def _inliers(
    first: Features, second: Features, *, pairs: NDArray[np.int64], warp: NDArray[np.float64]
) -> int:
    mine = first.xy[pairs[:, 0]].astype(np.float64)
    if not len(mine):
        return 0
    there = cv2.perspectiveTransform(mine[:, None], warp)[:, 0]
    return int((np.linalg.norm(there - second.xy[pairs[:, 1]], axis=1) <= _CLOSE_PX).sum())
