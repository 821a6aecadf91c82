"""Prior over camera positions: near the map's photos, along the paths that these trace.

It is combined with the position estimated from one photo by Bayes' rule. The map's photos around a position
are weighted by a Gaussian window; their scatter, corrected for the window, describes the density of cameras
there. Along a row of photos it is long and thin, so that a position off the row is drawn towards it but not
moved along it; where there are photos on all sides the prior has no effect.
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
"""Radius that contains 68 % of an isotropic Gaussian in the plane, over its standard deviation."""

_WINDOW = 1.5
"""Standard deviation of the window by which the photos around a position are weighted, place radii."""

_NARROW = 0.5
"""Share of the window's variance: photos that vary by more give no prior along that axis."""

_LONG = 0.5
"""Minimum standard deviation of photos along a path, place radii: with less they are a spot."""

_ACROSS = 0.1
"""Standard deviation of cameras across a path, place radii."""

_NONE = 1e-9
"""Sum of weights below which there are no photos around a position."""

_DOUBT = 2.5
"""Standard deviations off the path at which the prior fades out: the position is probably not on it."""


@dataclass(frozen=True, slots=True, eq=False)
class PathPrior:
    """Positions of a map's photos, as a prior."""

    photos: Array  # (n, 2) float64. Their distinct positions, map pixels.
    floor: NDArray[np.int64]  # (n,) int64. Ids of their floors.
    place_radius_px: float
    area_px2: float  # Area in which a camera can be

    @property
    def places(self) -> float:
        """Approximate number of places."""
        return max(self.area_px2 / (math.pi * self.place_radius_px**2), 2.0)


def fit_path_prior(
    position: Array, *, place_radius_px: float, floor: NDArray[np.int64] | None = None
) -> PathPrior:
    """Fit the prior to photos at (p, 2) map pixels; all are on one floor unless `floor` is given."""
    on = np.full(len(position), BASE_FLOOR) if floor is None else floor
    # Count grid cells that contain photos: most maps are paths rather than rectangles.
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
    """Combine a position with the prior.

    Args:
        position: Estimate from one photo.
        variance: Its variance along an axis, map pixels squared.
        weight: (n,) float64. Prior weight of the surroundings of each of `paths.photos`; uniform by default.
        floor: Floor of the position; photos on other floors are ignored.

    Returns:
        variance: (2,) float64. Of the result, along the more and the less certain axis: a path constrains
            positions only across it.
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
    # The window multiplies the density of cameras by a Gaussian, whose precision has to be subtracted.
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
    """Combine each computed position with the prior, and update its radius.

    Args:
        weight: (n,) float64. As for `apply_path_prior`.
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
