"""Where cameras are: about where the photos of the map were taken, along the paths that these trace.

A prior over positions, to be joined with what one photo says by Bayes' rule. The map's photos around a
position are seen through a Gaussian window; their scatter, freed of the window, is the density of cameras
there. Along a row of photos it is long and thin, so that what lies off the row is drawn across to it and
nothing is moved along it; where photos stand on all sides it says nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis

Array = NDArray[np.float64]

INSIDE_68 = math.sqrt(-2.0 * math.log(1.0 - 0.68))
"""Radius that holds 68 % of a round Gaussian over its spread."""

_WINDOW = 1.5
"""Spread of the window through which the photos around a position are seen, place radii."""

_NARROW = 0.5
"""Photos that vary by more than this share of the window's variance could be anywhere in it."""

_LONG = 0.5
"""Photos that spread less than this around a position, place radii, make a spot and no path."""

_ACROSS = 0.1
"""Spread of cameras across the path, place radii."""

_NONE = 1e-9
"""Sum of weights below which there are no photos around a position."""

_DOUBT = 2.5
"""A position that is more standard deviations off the path than this is not on it."""


@dataclass(frozen=True, slots=True, eq=False)
class PathPrior:
    """Where the photos of a map were taken.

    Attributes
    ----------
    photos : (n, 2) float64
        Their distinct positions, map pixels.
    floor : (n,) int64
        Ids of the floors of these.
    area_px2 : float
        Where a camera can be at all.
    """

    photos: Array
    floor: NDArray[np.int64]
    place_radius_px: float
    area_px2: float

    @property
    def places(self) -> float:
        """About how many places there are."""
        return max(self.area_px2 / (math.pi * self.place_radius_px**2), 2.0)


def fit_path_prior(
    position: Array, *, place_radius_px: float, floor: NDArray[np.int64] | None = None
) -> PathPrior:
    """Describe where the photos at (p, 2) map pixels were taken; all on one floor unless `floor` is given."""
    on = np.full(len(position), BASE_FLOOR) if floor is None else floor
    # Squares of a place radius that hold photos: a map is a path more often than it is a rectangle.
    squares = np.unique(np.column_stack([np.floor(position / place_radius_px), on]), axis=0)
    area = max(len(squares), 1) * place_radius_px**2
    distinct = np.unique(np.column_stack([position, on]), axis=0)
    return PathPrior(distinct[:, :2], distinct[:, 2].astype(np.int64), place_radius_px, area)


def apply_path_prior(
    position: MapPixel,
    variance: float,
    *,
    paths: PathPrior,
    weight: Array | None = None,
    floor: int = BASE_FLOOR,
) -> tuple[MapPixel, Array]:
    """Join a position with where cameras are.

    Parameters
    ----------
    position : MapPixel
        What one photo says.
    variance : float
        Of it, along an axis, map pixels squared.
    weight : (n,) float64, optional
        How probable the surroundings of each of `paths.photos` are; all the same without it.
    floor : int
        Of the position; photos of others say nothing.

    Returns
    -------
    variance : (2,) float64
        Of it, along the axis that is known better and along the other: a path says little of where along it.
    """
    at = np.array(position)
    off = paths.photos - at
    window = (_WINDOW * paths.place_radius_px) ** 2
    near = np.exp(-0.5 * (off**2).sum(1) / window)
    near = near * (paths.floor == floor)
    near = near if weight is None else near * weight
    mass = float(near.sum())
    if mass < _NONE:
        return position, np.array([variance, variance])
    middle = near @ off / mass
    apart = off - middle
    across = (_ACROSS * paths.place_radius_px) ** 2
    scatter = np.einsum("n,ni,nj->ij", near, apart, apart) / mass + across * np.eye(2)
    spreads, axes = np.linalg.eigh(scatter)
    # The window multiplies the density of cameras by a Gaussian, so that its precision is to be subtracted.
    precision = np.maximum(1.0 / spreads - 1.0 / (_NARROW * window), 0.0)
    if weight is None:
        precision[1] = 0.0
        precision[0] *= spreads[1] >= (_LONG * paths.place_radius_px) ** 2
    narrow = precision > 0.0
    row = np.where(narrow, axes.T @ middle / spreads / np.where(narrow, precision, 1.0), 0.0)
    foreseen = variance + 1.0 / np.where(narrow, precision, 1.0)
    precision *= np.exp(-0.5 * row**2 / foreseen / _DOUBT**2)
    left = 1.0 / (1.0 / variance + precision)
    return MapPixel(*map(float, at + axes @ (left * precision * row))), np.sort(left)


def apply_path_prior_to_answer(answer: Answer, paths: PathPrior, *, weight: Array | None = None) -> Answer:
    """Join each position that was computed with where cameras are, and update its radius.

    Parameters
    ----------
    weight : (n,) float64, optional
        As for `drawn`.
    """
    hypotheses = tuple(_on_paths(h, paths, weight) for h in answer.hypotheses)
    return replace(answer, hypotheses=hypotheses)


def _on_paths(hypothesis: Hypothesis, paths: PathPrior, weight: Array | None) -> Hypothesis:
    if hypothesis.kind != "position" or hypothesis.radius_px is None:
        return hypothesis
    position, variance = apply_path_prior(
        hypothesis.position, hypothesis.radius_px**2, paths=paths, weight=weight, floor=hypothesis.floor
    )
    return replace(hypothesis, position=position, radius_px=math.sqrt(variance[1]))
