"""Prior knowledge about a query: paths of the map's photos, a circle where it was taken, a compass reading.

The path prior is combined with the position estimated from one photo by Bayes' rule. The map's photos around
a position are weighted by a Gaussian window; their scatter, corrected for the window, describes the density
of cameras there. Along a row of photos it is long and thin, so that a position off the row is drawn towards
it but not moved along it; where there are photos on all sides the prior has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.bayes import reweight
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


_EDGE = 0.5
"""Standard deviation of the truth beyond the rim of the circle, radii: the rim is only approximate."""

_OUTLIER_CIRCLES = 0.1
"""Share of circles without information: of another day or place, or of a receiver between buildings."""


@dataclass(frozen=True, slots=True)
class CirclePrior:
    """Circle in or near which the photo was taken; map pixels."""

    x: float
    y: float
    radius: float

    def density(self, position: Array) -> Array:
        """Compute the density at (n, 2) positions relative to that at the centre; (n,)."""
        beyond = np.maximum(np.hypot(*(position - (self.x, self.y)).T) - self.radius, 0.0)
        density: Array = np.exp(-0.5 * (beyond / (_EDGE * self.radius)) ** 2)
        return density


def apply_circle_prior(answer: Answer, near: CirclePrior, *, paths: PathPrior) -> Answer:
    """Reweight the hypotheses of an answer by a circle.

    The circle restricts the prior over places from the whole map to its surroundings, except for the tenth of
    circles without information. It says little about whether the photo is on the map: see `reweight`.

    Args:
        paths: Paths of the map.

    Returns:
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    if not answer.hypotheses:
        return answer
    inside = near.density(np.array([h.position for h in answer.hypotheses]))
    # A circle contains at least one place, even if no photo of the map is in it.
    usual = max(float(near.density(paths.photos).mean()), 1.0 / paths.places)
    return reweight(
        answer, [_OUTLIER_CIRCLES + (1.0 - _OUTLIER_CIRCLES) * i / usual for i in inside.tolist()]
    )


def photo_weights(near: CirclePrior, paths: PathPrior) -> Array:
    """Compute the prior weight of the surroundings of each photo of `paths`; (n,)."""
    return _OUTLIER_CIRCLES / paths.places + (1.0 - _OUTLIER_CIRCLES) * near.density(paths.photos)


_SPREAD_DEG = 25.0
"""Standard deviation of a hand-held compass near steel and electronics against a computed heading."""

_OF_PHOTO_DEG = 40.0
"""Standard deviation of a query's heading about that of a matched photo, which sees the same scene."""

_OUTLIER_READINGS = 0.1
"""Share of compass readings without information: disturbed, or of the phone and not of its camera."""


def relative_to_north(answer: Answer, georeference: Georeference | None) -> Answer:
    """Convert headings from image-up to headings from north; without a georeference up is north.

    A heading becomes None where the georeference is undefined.
    """
    if georeference is None:
        return answer
    turned = tuple(_from_north(h, georeference) for h in answer.hypotheses)
    return replace(answer, hypotheses=turned)


def _from_north(hypothesis: Hypothesis, georeference: Georeference) -> Hypothesis:
    if hypothesis.heading_deg is None:
        return hypothesis
    heading = hypothesis.heading_deg - georeference.north_deg(hypothesis.position)
    return replace(hypothesis, heading_deg=heading % 360.0 if math.isfinite(heading) else None)


def apply_compass(
    answer: Answer, heading_deg: float, *, looked_deg: Mapping[int, float] = MappingProxyType({})
) -> Answer:
    """Reweight the hypotheses of an answer by a compass heading.

    The reading is normally distributed about the true heading, or in a tenth of the cases uniform. It is
    uniform, too, for hypotheses without a heading and for "not on this map".

    Args:
        heading_deg: Degrees clockwise from north.
        looked_deg: Known headings of the map's photos, by id: used for hypotheses without a heading.

    Returns:
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    return reweight(answer, [_likelihood(h, heading_deg, looked_deg) for h in answer.hypotheses])


def _likelihood(hypothesis: Hypothesis, compass_deg: float, looked_deg: Mapping[int, float]) -> float:
    """Compute the density of the reading relative to a uniform one."""
    heading, spread = hypothesis.heading_deg, _SPREAD_DEG
    if heading is None and hypothesis.experiences:
        heading, spread = looked_deg.get(hypothesis.experiences[0]), math.hypot(_SPREAD_DEG, _OF_PHOTO_DEG)
    if heading is None:
        return 1.0
    off = math.remainder(heading - compass_deg, 360.0)
    density = math.exp(-0.5 * (off / spread) ** 2) / (math.sqrt(2.0 * math.pi) * spread)
    return _OUTLIER_READINGS + (1.0 - _OUTLIER_READINGS) * 360.0 * density
