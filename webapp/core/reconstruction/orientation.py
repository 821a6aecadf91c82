"""Orientations of a map's photos from relative poses and known positions.

A relative pose gives the direction from one photo to the other in the frame of its camera; their positions
give that direction on the map. So each pair votes for two headings (1). These directions and the relative
rotations of pairs are averaged robustly (2: Hartley, Trumpf, Dai, Li, "Rotation averaging", 2013). Then all
matches together refine rotations and heights (3, `refine_extrinsics`). Finally `depths.py` triangulates the
points that several photos see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MapExtrinsics, empty_depths
from webapp.core.geometry.level_camera import LevelPrior
from webapp.core.geometry.robust import cauchy, geman_mcclure
from webapp.core.reconstruction.depths import sampson_error, triangulate_depths
from webapp.core.reconstruction.pairs import PhotoPairs, homogeneous
from webapp.core.tuning import DEFAULT, ExtrinsicsTuning

_FULL_PARALLAX = math.radians(2.0)
"""From this parallax on the direction between the cameras counts fully."""

Array = NDArray[np.float64]

_BINS = 120
_BIN_SPREAD = math.radians(9.0)

_TURN_SPREAD, _DIRECTION_SPREAD = 0.05, 0.12
"""Standard deviations of right pairs, radians."""

_HEIGHT_WEIGHT = 0.25
"""Weight of the vertical part of a direction: cameras are not all at the same height."""

_DAMPING, _MOST_TURN = 0.6, 0.3
_KNOWN = 0.3
"""Trust from which on a photo's orientation is used for its neighbours."""


def estimate_extrinsics(
    pairs: PhotoPairs,
    position: Array,
    *,
    ray_sigma: Array,
    place_radius_px: float,
    tuning: ExtrinsicsTuning = DEFAULT.extrinsics,
) -> MapExtrinsics:
    """Estimate rotations and heights of a map's photos, and depths of their keypoints.

    Args:
        position: (p, 2) float64. Positions of all photos, map pixels.
        ray_sigma: (p,) float64. Standard deviation of a keypoint of each photo, at depth 1; see
            `IndexedMap.ray_sigmas`.
        place_radius_px: Scale of heights.
    """
    apart = np.hypot(*(position[pairs.second] - position[pairs.first]).T) > 0.0
    which = np.flatnonzero(apart)
    pairs = pairs.subset(which, first=pairs.first[which], second=pairs.second[which])
    if not len(pairs):
        count = len(position)
        return MapExtrinsics(
            so3.from_heading(np.zeros(count)), np.zeros(count), np.zeros(count), empty_depths()
        )
    directions = _baseline_directions(pairs, position)
    heading, known = _vote_headings(directions, len(position))
    start = so3.from_heading(heading)
    rotation, trust = _average_rotations(pairs, directions, start=start, known=known, tuning=tuning)
    rotation, height = refine_extrinsics(
        pairs.thinned(tuning.matches_per_pair),
        position,
        rotation=rotation,
        ray_sigma=ray_sigma,
        place_radius_px=place_radius_px,
        tuning=tuning,
    )
    found = MapExtrinsics(rotation, height, trust, empty_depths())
    depths = triangulate_depths(
        pairs,
        position,
        extrinsics=found,
        ray_sigma=ray_sigma,
        place_radius_px=place_radius_px,
        tuning=tuning,
    )
    return replace(found, depths=depths.fuse())


@dataclass(frozen=True, slots=True, eq=False)
class _Directions:
    """Directions from photos to others, v = 2 k for k pairs."""

    photo: NDArray[np.int64]  # (v,) int64
    seen: Array  # (v, 3) float64. Direction to the other camera in the photo's frame.
    real: Array  # (v, 3) float64. The same direction in the world, level.
    weight: Array  # (v,) float64


def _baseline_directions(pairs: PhotoPairs, position: Array) -> _Directions:
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


def _vote_headings(views: _Directions, photos: int) -> tuple[Array, NDArray[np.bool_]]:
    """Let directions vote for headings; returns the best (p,), radians, and which photos have votes (p,)."""
    voted = np.arctan2(views.real[:, 0], views.real[:, 2]) - np.arctan2(views.seen[:, 0], views.seen[:, 2])
    bins = np.floor(np.remainder(voted, 2.0 * np.pi) * _BINS / (2.0 * np.pi)).astype(np.int64) % _BINS
    votes = np.bincount(views.photo * _BINS + bins, weights=views.weight, minlength=photos * _BINS)
    votes = votes.reshape(photos, _BINS)
    offset = so3.wrap(2.0 * np.pi * np.arange(_BINS) / _BINS)
    kernel = np.fft.rfft(geman_mcclure(offset**2, _BIN_SPREAD))
    smooth = np.fft.irfft(np.fft.rfft(votes, axis=1) * kernel, _BINS, axis=1)
    heading = (smooth.argmax(1) + 0.5) * 2.0 * np.pi / _BINS
    return heading, votes.sum(1) > 0.0


def _average_rotations(
    pairs: PhotoPairs, views: _Directions, *, start: Array, known: NDArray[np.bool_], tuning: ExtrinsicsTuning
) -> tuple[Array, Array]:
    """Average relative rotations and directions; returns rotations and the trust in each."""
    rotation, photos = start, len(start)
    to = np.concatenate([pairs.second, pairs.first])
    source = np.concatenate([pairs.first, pairs.second])
    turn = np.concatenate([pairs.rotation, np.swapaxes(pairs.rotation, 1, 2)])
    weight = np.concatenate([pairs.trust, pairs.trust])
    known = known.copy()
    trust = np.zeros(photos)
    for wider in tuning.averaging.factors():
        wanted = turn @ rotation[source]
        off = so3.log(np.swapaxes(wanted, 1, 2) @ rotation[to])
        by_turn = weight * known[source] * geman_mcclure((off**2).sum(1), _TURN_SPREAD * wider)
        strength = by_turn / (_TURN_SPREAD * wider) ** 2
        matrix = _scatter_add(to, strength[:, None, None] * np.eye(3), photos)
        vector = _scatter_add(to, strength[:, None] * off, photos)
        more = _direction_terms(views, rotation, spread=_DIRECTION_SPREAD * wider)
        matrix, vector = matrix + more.matrix, vector + more.vector
        level = tuning.averaging_level.normal_equations(rotation)
        matrix, vector = matrix + level[0], vector + level[1]
        step = _DAMPING * so3.solve_batched(matrix + 1e-6 * np.eye(3), vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step, _MOST_TURN))
        gained = _scatter_add(to, by_turn[:, None], photos)[:, 0]
        known |= gained > _KNOWN
        trust = gained + _scatter_add(views.photo, more.agrees[:, None], photos)[:, 0]
    return rotation, trust


class _DirectionTerms(NamedTuple):
    """Normal equations of directions, (p, 3, 3) and (p, 3), and the agreement of each direction, (v,)."""

    matrix: Array
    vector: Array
    agrees: Array


def _direction_terms(views: _Directions, rotation: Array, *, spread: float) -> _DirectionTerms:
    seen = np.einsum("vji,vj->vi", rotation[views.photo], views.seen)
    off = views.real - seen
    agrees = views.weight * geman_mcclure((off**2).sum(1), spread)
    # A small rotation d moves the seen direction s by d x s.
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


def _scatter_add(where: NDArray[np.int64], values: Array, count: int) -> Array:
    """Sum (n, ...) values by their index `where`, into (count, ...)."""
    flat = values.reshape(len(values), -1)
    total = np.empty((count, flat.shape[1]))
    for number, column in enumerate(flat.T):
        total[:, number] = np.bincount(where, weights=column, minlength=count)
    return total.reshape(count, *values.shape[1:])


_REFINED_SHARE = 0.6
"""Share of each step that is taken, because all photos move at once, each as if the others were fixed."""

_STIFFNESS = 1.05
_MOST_REFINED_TURN, _MOST_RISE = 0.1, 0.1
_TRUSTED_MATCHES = 5.0
"""Factor of a match's weight, the trust in its pair over the root of the pair's number of matches."""


def refine_extrinsics(
    pairs: PhotoPairs,
    position: Array,
    *,
    rotation: Array,
    ray_sigma: Array,
    place_radius_px: float,
    tuning: ExtrinsicsTuning = DEFAULT.extrinsics,
) -> tuple[Array, Array]:
    """Refine rotations and heights by all matches.

    Args:
        pairs: Pairs of photos at different positions.
        position: (p, 2) float64. Map pixels.
        rotation: (p, 3, 3) float64. Camera from world, initial values.
        ray_sigma: (p,) float64. Standard deviation of a keypoint of each photo, at depth 1.

    Returns:
        rotation: (p, 3, 3) float64
        height: (p,) float64. Downwards, map pixels.
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    weight = np.repeat(_TRUSTED_MATCHES * pairs.trust / np.sqrt(np.maximum(lengths, 1)), lengths)
    ours, theirs = homogeneous(pairs.ray_first), homogeneous(pairs.ray_second)
    world = np.column_stack([position[:, 0], np.zeros(len(position)), -position[:, 1]])
    length = np.linalg.norm(world[second] - world[first], axis=1)
    height_sigma = tuning.height_sigma * place_radius_px
    for factor in tuning.refinement.factors():
        error = sampson_error(
            np.einsum("mji,mj->mi", rotation[first], ours),
            np.einsum("mji,mj->mi", rotation[second], theirs),
            baseline=(world[second] - world[first]) / length[:, None],
            cameras=(rotation[first], rotation[second]),
            sigmas=(ray_sigma[first], ray_sigma[second]),
        )
        sigma = factor * error.sigma
        strength = weight * cauchy(error.value**2, sigma) / sigma**2
        rise = (error.d_height / length)[:, None]
        normal = _Equations.empty(len(world))
        normal.add(first, np.column_stack([error.d_first, -rise]), value=error.value, strength=strength)
        normal.add(second, np.column_stack([error.d_second, rise]), value=error.value, strength=strength)
        normal.add_priors(rotation, world[:, 1], level=tuning.refinement_level, height_sigma=height_sigma)
        step = _REFINED_SHARE * so3.solve_batched(normal.matrix, normal.vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step[:, :3], _MOST_REFINED_TURN))
        most = _MOST_RISE * place_radius_px
        world[:, 1] += np.clip(step[:, 3], -most, most)
    return rotation, world[:, 1]


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of p photos: a rotation vector and the height of each."""

    matrix: Array  # (p, 4, 4) float64
    vector: Array  # (p, 4) float64

    @classmethod
    def empty(cls, photos: int) -> _Equations:
        return cls(np.zeros((photos, 4, 4)), np.zeros((photos, 4)))

    def add(self, photo: NDArray[np.int64], jacobian: Array, *, value: Array, strength: Array) -> None:
        count = len(self.vector)
        weighted = strength[:, None] * jacobian
        for row in range(4):
            self.vector[:, row] -= np.bincount(photo, weights=weighted[:, row] * value, minlength=count)
            for column in range(row, 4):
                values = weighted[:, row] * jacobian[:, column]
                total = np.bincount(photo, weights=values, minlength=count)
                self.matrix[:, row, column] += total
                if column != row:
                    self.matrix[:, column, row] += total

    def add_priors(self, rotation: Array, height: Array, *, level: LevelPrior, height_sigma: float) -> None:
        """Add the priors of level cameras at equal heights, which make every photo's equations solvable."""
        matrix, vector = level.normal_equations(rotation)
        self.matrix[:, :3, :3] += matrix
        self.vector[:, :3] += vector
        self.matrix[:, 3, 3] += 1.0 / height_sigma**2
        self.vector[:, 3] -= height / height_sigma**2
        self.matrix[...] += 1e-3 * np.eye(4)
        turns = np.arange(3)
        self.matrix[:, turns, turns] *= _STIFFNESS
