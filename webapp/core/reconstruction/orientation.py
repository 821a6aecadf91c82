"""Orientations of a map's photos from relative poses and known positions.

A relative pose tells in which direction, seen from one photo, the other was taken; their positions tell where
that direction is on the map. So each pair votes for two headings (1); what pairs know of the turn from photo
to photo is averaged with it, robustly (2: Hartley, Trumpf, Dai, Li, "Rotation averaging", 2013); and at last
all matches together correct headings, pitches and heights (3, `refinement.py`). In the end `depths.py` tells
how far away is what several photos see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MapExtrinsics, empty_depths
from webapp.core.reconstruction.depths import triangulate_depths
from webapp.core.reconstruction.pairs import PhotoPairs
from webapp.core.reconstruction.refinement import refine_extrinsics

_FULL_PARALLAX = math.radians(2.0)
"""From this parallax on the direction between the cameras counts fully."""

_BINS = 120
_BIN_SPREAD = math.radians(9.0)

_ROUNDS = 60
_TURN_SPREAD, _DIRECTION_SPREAD = 0.05, 0.12
"""Of right pairs, radians."""

_WIDER, _NARROWING = 4.0, 0.9
"""Spreads begin so much wider and shrink by this factor a round, so that a bad start can be left."""

_ROLL_SPREAD, _PITCH_SPREAD = 0.04, 0.2
"""How level cameras are held, radians."""

_TILT_WEIGHT = 0.3
_HEIGHT_WEIGHT = 0.25
"""The vertical part of a direction counts less: cameras are not all equally high."""

_DAMPING, _MOST_TURN = 0.6, 0.3
_KNOWN = 0.3
"""Trust from which on a photo's orientation helps its neighbours."""


def estimate_extrinsics(
    pairs: PhotoPairs, position: NDArray[np.float64], *, place_radius_px: float
) -> MapExtrinsics:
    """Find out how photos were held.

    Parameters
    ----------
    pairs : Pairs
    position : (p, 2) float64
        Of all photos, map pixels.
    place_radius_px : float
        Scale of heights.

    Returns
    -------
    Orientations
    """
    apart = np.hypot(*(position[pairs.second] - position[pairs.first]).T) > 0.0
    which = np.flatnonzero(apart)
    pairs = pairs.subset(which, first=pairs.first[which], second=pairs.second[which])
    if not len(pairs):
        count = len(position)
        return MapExtrinsics(
            so3.from_heading(np.zeros(count)), np.zeros(count), np.zeros(count), empty_depths()
        )
    views = _baseline_directions(pairs, position)
    heading, known = _vote_headings(views, len(position))
    rotation, trust = _average_rotations(pairs, views, start=so3.from_heading(heading), known=known)
    rotation, height = refine_extrinsics(pairs, position, rotation=rotation, scale_px=place_radius_px)
    found = MapExtrinsics(rotation, height, trust, empty_depths())
    seen = triangulate_depths(pairs, position, extrinsics=found, place_radius_px=place_radius_px)
    return replace(found, depths=seen.fuse())


@dataclass(frozen=True, slots=True, eq=False)
class _Directions:
    """Who saw whom where; v = 2 k of them.

    Attributes
    ----------
    photo : (v,) int64
    seen : (v, 3) float64
        Direction to the other camera in the photo's frame.
    real : (v, 3) float64
        The same direction in the world, level.
    weight : (v,) float64
    """

    photo: NDArray[np.int64]
    seen: NDArray[np.float64]
    real: NDArray[np.float64]
    weight: NDArray[np.float64]


def _baseline_directions(pairs: PhotoPairs, position: NDArray[np.float64]) -> _Directions:
    step = position[pairs.second] - position[pairs.first]
    real = np.column_stack([step[:, 0], np.zeros(len(step)), -step[:, 1]])
    real /= np.linalg.norm(real, axis=1)[:, None]
    seen = -np.einsum("kji,kj->ki", pairs.rotation, pairs.translation)
    weight = pairs.trust * np.minimum(pairs.parallax / _FULL_PARALLAX, 1.0) ** 2
    return _Directions(
        photo=np.concatenate([pairs.first, pairs.second]),
        seen=np.concatenate([seen, pairs.translation]),
        real=np.concatenate([real, -real]),
        weight=np.concatenate([weight, weight]),
    )


def _vote_headings(views: _Directions, photos: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Let directions vote for headings; returns the most voted (p,), radians, and who has any (p,)."""
    voted = np.arctan2(views.real[:, 0], views.real[:, 2]) - np.arctan2(views.seen[:, 0], views.seen[:, 2])
    bins = np.floor(np.remainder(voted, 2.0 * np.pi) * _BINS / (2.0 * np.pi)).astype(np.int64) % _BINS
    votes = np.bincount(views.photo * _BINS + bins, weights=views.weight, minlength=photos * _BINS)
    votes = votes.reshape(photos, _BINS)
    offset = so3.wrap(2.0 * np.pi * np.arange(_BINS) / _BINS)
    kernel = np.fft.rfft(_kernel(offset**2, _BIN_SPREAD))
    smooth = np.fft.irfft(np.fft.rfft(votes, axis=1) * kernel, _BINS, axis=1)
    heading = (smooth.argmax(1) + 0.5) * 2.0 * np.pi / _BINS
    return heading, votes.sum(1) > 0.0


def _kernel(squared: NDArray[np.float64], spread: float) -> NDArray[np.float64]:
    """Weight of a residual, from 1 to 0 (Geman and McClure)."""
    weight: NDArray[np.float64] = 1.0 / (1.0 + squared / spread**2) ** 2
    return weight


def _average_rotations(
    pairs: PhotoPairs, views: _Directions, *, start: NDArray[np.float64], known: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Average turns and directions; returns rotations and the trust in each."""
    rotation, photos = start, len(start)
    to = np.concatenate([pairs.second, pairs.first])
    source = np.concatenate([pairs.first, pairs.second])
    turn = np.concatenate([pairs.rotation, np.swapaxes(pairs.rotation, 1, 2)])
    weight = np.concatenate([pairs.trust, pairs.trust])
    known = known.copy()
    trust = np.zeros(photos)
    for number in range(_ROUNDS):
        wider = max(1.0, _WIDER * _NARROWING**number)
        wanted = turn @ rotation[source]
        off = so3.log(np.swapaxes(wanted, 1, 2) @ rotation[to])
        by_turn = weight * known[source] * _kernel((off**2).sum(1), _TURN_SPREAD * wider)
        strength = by_turn / (_TURN_SPREAD * wider) ** 2
        matrix = _scatter_add(to, strength[:, None, None] * np.eye(3), photos)
        vector = _scatter_add(to, strength[:, None] * off, photos)
        more = _direction_terms(views, rotation, spread=_DIRECTION_SPREAD * wider)
        matrix, vector = matrix + more.matrix, vector + more.vector
        _add_tilts(matrix, vector, rotation)
        step = _DAMPING * so3.solve_batched(matrix + 1e-6 * np.eye(3), vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step, _MOST_TURN))
        gained = _scatter_add(to, by_turn[:, None], photos)[:, 0]
        known |= gained > _KNOWN
        trust = gained + _scatter_add(views.photo, more.agrees[:, None], photos)[:, 0]
    return rotation, trust


class _DirectionTerms(NamedTuple):
    """What directions want: normal equations (p, 3, 3), (p, 3), and how far each agrees, (v,)."""

    matrix: NDArray[np.float64]
    vector: NDArray[np.float64]
    agrees: NDArray[np.float64]


def _direction_terms(views: _Directions, rotation: NDArray[np.float64], *, spread: float) -> _DirectionTerms:
    seen = np.einsum("vji,vj->vi", rotation[views.photo], views.seen)
    off = views.real - seen
    agrees = views.weight * _kernel((off**2).sum(1), spread)
    # A small turn d moves the seen direction s by d x s.
    jacobian = np.zeros((len(seen), 3, 3))
    jacobian[:, 0, 1], jacobian[:, 0, 2], jacobian[:, 1, 2] = seen[:, 2], -seen[:, 1], seen[:, 0]
    jacobian -= np.swapaxes(jacobian, 1, 2)
    transposed = np.swapaxes(jacobian, 1, 2) * np.array([1.0, _HEIGHT_WEIGHT, 1.0])
    strength = agrees / spread**2
    pull = strength[:, None] * np.einsum("vij,vj->vi", transposed, off)
    return _DirectionTerms(
        _scatter_add(views.photo, strength[:, None, None] * (transposed @ jacobian), len(rotation)),
        _scatter_add(views.photo, pull, len(rotation)),
        agrees,
    )


def _add_tilts(
    matrix: NDArray[np.float64], vector: NDArray[np.float64], rotation: NDArray[np.float64]
) -> None:
    """Add that cameras are held about level, in roll more than in pitch."""
    for (sine, row), spread in zip(
        so3.roll_pitch_sines(rotation), (_ROLL_SPREAD, _PITCH_SPREAD), strict=True
    ):
        strength = _TILT_WEIGHT / spread**2
        matrix += strength * row[:, :, None] * row[:, None, :]
        vector -= strength * row * sine[:, None]


def _scatter_add(where: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sum (n, ...) values by their number, into (count, ...)."""
    flat = values.reshape(len(values), -1)
    total = np.empty((count, flat.shape[1]))
    for number, column in enumerate(flat.T):
        total[:, number] = np.bincount(where, weights=column, minlength=count)
    return total.reshape(count, *values.shape[1:])
