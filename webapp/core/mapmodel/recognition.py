"""Estimates how well each part of a map is recognised in each direction, with the uncertainty of that.

A photo recognises one taken at its own position in its own direction with some probability, which falls with
distance and angle by a kernel; several photos do so independently of each other (a noisy OR: J. Pearl,
"Probabilistic Reasoning in Intelligent Systems", 1988). In logarithms their support adds up: with the support
S, a photo is recognised with the probability 1 - exp(-S).

Trials are the map's own photos, localized while hidden from the map. If there are enough, the probability at
a photo's own position and the kernel's length are their maximum likelihood estimates. The support has a
factor that varies over the map, since a hedge is not a facade. It has a gamma prior around 1, as rates in
disease mapping (D. Clayton and J. Kaldor, Biometrics 43, 1987); each trial is weighted around its position by
the kernel, as in continuous correlated beta processes (R. Goetschalckx, P. Poupart and J. Hoey, IJCAI 2011).
The uncertainty of the recognised share is that of the factor; without trials it is large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIRECTIONS = 8
"""North, north-east and so on, clockwise."""

STEP_DEG = 360.0 / DIRECTIONS

_RECOGNISES = 0.8
_LENGTH = 0.5
"""Defaults for too few trials: the probability at a photo's own position, and the length in place radii."""

_PROBABILITIES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.97)
_LENGTHS = (0.25, 0.375, 0.5, 0.75, 1.0, 1.5)
"""Candidates of both for more trials, length in place radii."""

_FEWEST_TRIALS, _MOST_FITTED, _MOST_TRIALS = 20, 300, 1000
_FAR = 3.0
"""Distance beyond which photos are ignored, in lengths of the kernel."""

_LEAST = 1e-3
"""Lower limit of the support of a trial, so that a success is never impossible."""

_ANGLE_SIGMA_DEG = 30.0
"""Photos with the usual field of view of 60 to 70 degrees share a third of it if turned by 45."""

_PRIOR = 1.0
"""Weight of the prior of the factor, in units of support."""

_ROUNDS = 5
"""Iterations of expectation maximisation, after which the factor hardly changes."""

_CELLS_PER_RADIUS = 4.0
_MOST_CELLS = 1500
_COARSER = 1.25


@dataclass(frozen=True, slots=True, eq=False)
class PhotoTrials:
    """The photos of a map, and whether each was recognised while hidden."""

    position: Array  # (n, 2) float64. On the image, in a unit of constant length.
    heading_deg: Array  # (n,) float64. Clockwise from north; NaN where it is not known.
    success: Array  # (n,) float64. Between 0 and 1; NaN for a photo that was not tried.
    # (n,) int64. Id of the photo: a panorama is several rows, one for each direction.
    photo: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle parallel to the image's sides, in the unit of the photos."""

    left: float
    top: float
    right: float
    bottom: float

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points (n, 2) are inside."""
        low, high = (self.left, self.top), (self.right, self.bottom)
        return np.asarray(((points >= low) & (points <= high)).all(axis=1))


@dataclass(frozen=True, slots=True)
class RecognitionKernel:
    """Probability of recognition by distance from a photo."""

    probability: float  # At its own position, in its own direction
    length: float  # Standard deviation of the Gaussian kernel of distance


@dataclass(frozen=True, slots=True, eq=False)
class RecognitionGrid:
    """Recognition on square cells: those near photos and those of the requested area."""

    cell: Array  # (c, 2) float64. Centres of the cells.
    side: float  # Side of a cell
    reach: float  # Distance from photos within which people walk
    kernel: RecognitionKernel
    factor: Array  # (c, DIRECTIONS) float64. Factor of the support by photos.
    # `mean`, `sigma`: (c, DIRECTIONS) float64. Share of photos that are recognised, and its standard
    # deviation.
    mean: Array
    sigma: Array
    wanted: NDArray[np.bool_]  # (c,) bool. Cells of the requested area.

    @property
    def share(self) -> float:
        """Mean over the area; 0 for an empty one."""
        return float(self.mean[self.wanted].mean()) if self.wanted.any() else 0.0


def estimate_recognition(
    photos: PhotoTrials, *, radius: float, image: Rectangle, area: Rectangle | None = None
) -> RecognitionGrid:
    """Estimate recognition within a radius of photos and in the area, never outside of the image.

    Args:
        radius: Distance from photos within which people walk; the place radius of the map.
        area: The requested area; by default all cells near photos.
    """
    side, index = _cells(photos.position, radius=radius, image=image, area=area)
    cell = _middles(index, side)
    tried = _evenly(np.flatnonzero(np.isfinite(photos.success)), _MOST_TRIALS)
    kernel = _fit(photos, tried, radius)
    kernel = replace(kernel, length=max(kernel.length, side))
    towards = _directions(photos.heading_deg)
    own = _cell_numbers(index, _own_cells(photos.position, side=side, image=image))
    near = own >= 0
    count = np.zeros((len(cell), DIRECTIONS))
    np.add.at(count, own[near], towards[near])
    support = _support(cell, count, kernel)
    known = np.isfinite(photos.heading_deg[tried, None])
    weights = (
        distance_kernel(cell, photos.position[tried], length=kernel.length),
        _shares(photos, tried)[:, None] * np.where(known, towards[tried] @ angle_kernel(), 1.0),
    )
    promised = _pairs(photos, tried, reach=_FAR * kernel.length).support(kernel)
    factor, deviation = _factor(promised, photos.success[tried], weights=weights)
    missed = np.exp(-factor * support)
    sigma = np.minimum(missed * support * deviation, 0.5)
    wanted = np.ones(len(cell), np.bool_) if area is None else area.holds(cell)
    return RecognitionGrid(cell, side, radius, kernel, factor, 1.0 - missed, sigma, wanted)


def _factor(promised: Array, success: Array, *, weights: tuple[Array, Array]) -> tuple[Array, Array]:
    """Estimate the factor of the support, (c, DIRECTIONS), and its standard deviation.

    The number of photos that recognise a trial is modelled as a Poisson variable, of which a trial only shows
    whether it is zero. A success counts with the expected number, which depends on the factor.

    Args:
        promised, success: (n,) float64. Support of the trials, and their results.
        weights: tuple of (c, n) and (n, DIRECTIONS) float64. Weights of the trials, by distance and by angle.
    """
    at, around = weights
    exposure = _PRIOR + at @ (around * promised[:, None])
    factor = np.ones_like(exposure)
    seen = exposure
    for _ in range(_ROUNDS):
        seen = np.full_like(exposure, _PRIOR)
        for direction in range(DIRECTIONS):
            mean = np.maximum(factor[:, [direction]] * promised, _LEAST)
            worth = mean / -np.expm1(-mean) * success
            seen[:, direction] += (at * worth) @ around[:, direction]
        factor = seen / exposure
    return factor, np.sqrt(seen) / exposure


def _shares(photos: PhotoTrials, tried: NDArray[np.int64]) -> Array:
    """Return the weights of trials, (n,): the rows of a panorama count as one trial together."""
    _, number, rows = np.unique(photos.photo, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / rows[number[tried]], np.float64)


def _evenly(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    return numbers[:: max(1, -(-len(numbers) // most))]


@dataclass(frozen=True, slots=True, eq=False)
class _TrialPairs:
    """Pairs of a trial and another photo near it: number of the trial, squared distance, weight by angle."""

    trial: NDArray[np.int64]
    squared: Array
    around: Array
    trials: int

    def support(self, kernel: RecognitionKernel) -> Array:
        """Return the total support of the photos for each trial, (trials,)."""
        at = np.exp(-self.squared / (2.0 * kernel.length**2))
        given = -np.log1p(-kernel.probability * at * self.around)
        return np.asarray(np.bincount(self.trial, given, minlength=self.trials), np.float64)


def _pairs(photos: PhotoTrials, tried: NDArray[np.int64], *, reach: float) -> _TrialPairs:
    rows = []
    for number, photo in enumerate(tried.tolist()):
        squared = ((photos.position - photos.position[photo]) ** 2).sum(axis=1)
        squared[photos.photo == photos.photo[photo]] = np.inf  # a panorama was hidden as a whole
        near = np.flatnonzero(squared <= reach**2)
        turn = np.abs((photos.heading_deg[near] - photos.heading_deg[photo] + 180.0) % 360.0 - 180.0)
        around = np.where(np.isfinite(turn), _of_angle(np.nan_to_num(turn)), angle_kernel()[0].mean())
        rows.append(np.column_stack([np.full(len(near), number), squared[near], around]))
    table = np.concatenate([*rows, np.empty((0, 3))])
    return _TrialPairs(table[:, 0].astype(np.int64), table[:, 1], table[:, 2], len(tried))


def _fit(photos: PhotoTrials, tried: NDArray[np.int64], radius: float) -> RecognitionKernel:
    """Return the maximum likelihood estimate of the kernel from the trials, or the default for too few."""
    if _shares(photos, tried).sum() < _FEWEST_TRIALS:
        return RecognitionKernel(_RECOGNISES, _LENGTH * radius)
    some = _evenly(tried, _MOST_FITTED)
    success, share = photos.success[some], _shares(photos, some)
    pairs = _pairs(photos, some, reach=_FAR * max(_LENGTHS) * radius)

    def unlikely(kernel: RecognitionKernel) -> float:
        support = np.maximum(pairs.support(kernel), _LEAST)
        return float(share @ ((1.0 - success) * support - success * np.log(-np.expm1(-support))))

    return min(
        (RecognitionKernel(p, share * radius) for p in _PROBABILITIES for share in _LENGTHS), key=unlikely
    )


def distance_kernel(first: Array, second: Array, *, length: float) -> Array:
    """Return the weights (n, m) between points (n, 2) and (m, 2); 1 at the same position."""
    squared = ((first[:, None, :] - second[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(np.exp(-squared / (2.0 * length**2)))


def angle_kernel() -> Array:
    """Return the weights between directions, (DIRECTIONS, DIRECTIONS); symmetric, 1 on the diagonal."""
    steps = np.arange(DIRECTIONS)
    apart = (steps[:, None] - steps + DIRECTIONS / 2) % DIRECTIONS - DIRECTIONS / 2
    return _of_angle(np.asarray(apart * STEP_DEG, np.float64))


def _of_angle(turn_deg: Array) -> Array:
    return np.asarray(np.exp(-(turn_deg**2) / (2.0 * _ANGLE_SIGMA_DEG**2)))


def _support(cell: Array, count: Array, kernel: RecognitionKernel) -> Array:
    """Return the total support (c, DIRECTIONS) by photos, given their number by cell and direction."""
    taken = np.flatnonzero(count.any(axis=1))
    at, around = distance_kernel(cell, cell[taken], length=kernel.length), angle_kernel()[0]
    support = np.zeros_like(count)
    for turn in range(DIRECTIONS):
        weight = -np.log1p(-kernel.probability * around[turn] * at)
        support += weight @ np.roll(count[taken], turn, axis=1)
    return support


def _directions(heading_deg: Array) -> Array:
    """Distribute each photo over the two directions next to its heading, or over all; (n, DIRECTIONS)."""
    shares = np.full((len(heading_deg), DIRECTIONS), 1.0 / DIRECTIONS)
    known = np.flatnonzero(np.isfinite(heading_deg))
    turns = heading_deg[known] % 360.0 / STEP_DEG
    below = np.floor(turns).astype(int)
    shares[known] = 0.0
    shares[known, below % DIRECTIONS] = 1.0 - (turns - below)
    shares[known, (below + 1) % DIRECTIONS] += turns - below
    return shares


def _cells(
    position: Array, *, radius: float, image: Rectangle, area: Rectangle | None
) -> tuple[float, NDArray[np.int64]]:
    """Return the side of the cells, and their columns and rows; coarser if there would be too many."""
    side = radius / _CELLS_PER_RADIUS
    if area is not None:
        size = (area.right - area.left) * (area.bottom - area.top)
        side = max(side, math.sqrt(size / _MOST_CELLS))
    while True:
        own = _own_cells(position, side=side, image=image)
        found = [_around(own, reach=radius, side=side)]
        found += [] if area is None else [_inside(area, side)]
        index = np.unique(np.concatenate(found), axis=0)
        index = index[image.holds(_middles(index, side))]
        if len(index) <= _MOST_CELLS:
            return side, index
        side *= _COARSER


def _middles(index: NDArray[np.int64], side: float) -> Array:
    return np.asarray((index + 0.5) * side, np.float64)


def _own_cells(position: Array, *, side: float, image: Rectangle) -> NDArray[np.int64]:
    """Return the cells of photos; at the edges of the image the nearest ones whose centres are on it."""
    own = np.floor(position / side).astype(np.int64)
    middle, on_image = _middles(own, side), image.holds(position)[:, None]
    own -= on_image & (middle > (image.right, image.bottom))
    own += on_image & (middle < (image.left, image.top))
    return own


def _around(own: NDArray[np.int64], *, reach: float, side: float) -> NDArray[np.int64]:
    """Return the cells with photos, and those whose centres are within reach of them."""
    own = np.unique(own, axis=0)
    steps = np.arange(-math.ceil(reach / side), math.ceil(reach / side) + 1)
    columns, rows = np.meshgrid(steps, steps)
    offsets = np.column_stack([columns.ravel(), rows.ravel()])
    offsets = offsets[np.hypot(*offsets.T) * side <= reach]
    return np.unique((own[:, None, :] + offsets[None, :, :]).reshape(-1, 2), axis=0)


def _inside(area: Rectangle, side: float) -> NDArray[np.int64]:
    columns = np.arange(math.floor(area.left / side), math.ceil(area.right / side))
    rows = np.arange(math.floor(area.top / side), math.ceil(area.bottom / side))
    x, y = np.meshgrid(columns, rows)
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)


def _cell_numbers(index: NDArray[np.int64], own: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row of each cell in an index of cells; -1 if it is not in it."""
    known = {(int(column), int(row)): number for number, (column, row) in enumerate(index)}
    return np.array([known.get((column, row), -1) for column, row in own.tolist()], np.int64)
