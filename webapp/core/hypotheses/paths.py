"""Where cameras are: about where the photos of the map were taken, along the paths that these trace.

A prior over positions, to be joined with what one photo says by Bayes' rule. Around a position, the map's
photos are summed up by one Gaussian: along a row of photos it is long and thin, so that what lies beside the
row is drawn across to it and nothing is moved along it; where photos stand in all directions it is wide and
moves little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis

Array = NDArray[np.float64]

INSIDE_68 = math.sqrt(-2.0 * math.log(1.0 - 0.68))
"""Radius that holds 68 % of a round Gaussian over its spread."""

_AROUND = 2.0
"""Photos within about so many place radii tell how the path runs."""

_BESIDE = 0.3
"""Spread of cameras beside the path, place radii: a little more than half a spacing of the photos."""

_ANYWHERE = 0.005
"""Share of cameras that are on no path."""

_ERR_TOGETHER = 0.25
"""Least 68 % radius of an estimate, place radii: so far the map's own positions may be off."""


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Where the photos of a map were taken.

    Attributes
    ----------
    photos : (n, 2) float64
        Their distinct positions, map pixels.
    place_radius_px : float
    area_px2 : float
        Where a camera can be at all.
    """

    photos: Array
    place_radius_px: float
    area_px2: float

    @property
    def places(self) -> float:
        """About how many places there are."""
        return max(self.area_px2 / (math.pi * self.place_radius_px**2), 2.0)


def paths_of(position: Array, *, place_radius_px: float) -> Paths:
    """Describe where the photos at (p, 2) map pixels were taken."""
    # Squares of a place radius that hold photos: a map is a path more often than it is a rectangle.
    squares = np.unique(np.floor(position / place_radius_px), axis=0)
    area = max(len(squares), 1) * place_radius_px**2
    return Paths(np.unique(position, axis=0), place_radius_px, area)


def drawn(
    position: MapPixel, variance: float, *, paths: Paths, weight: Array | None = None
) -> tuple[MapPixel, float]:
    """Join a position with where cameras are.

    Parameters
    ----------
    position : MapPixel
        What one photo says.
    variance : float
        Of it, along an axis, map pixels squared.
    paths : Paths
    weight : (n,) float64, optional
        How probable the surroundings of each of `paths.photos` are; all the same without it.

    Returns
    -------
    position : MapPixel
    variance : float
        The mean of both axes.
    """
    at = np.array(position)
    off = paths.photos - at
    near = np.exp(-0.5 * (off**2).sum(1) / (_AROUND * paths.place_radius_px) ** 2)
    near = near if weight is None else near * weight
    mass = float(near.sum())
    if mass < 1e-9:
        return position, variance
    middle = near @ off / mass
    apart = off - middle
    beside = (_BESIDE * paths.place_radius_px) ** 2
    path = np.einsum("n,ni,nj->ij", near, apart, apart) / mass + beside * np.eye(2)
    both = path + variance * np.eye(2)
    squared = float(middle @ np.linalg.solve(both, middle))
    foreseen = math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(both))))
    here = (1.0 - _ANYWHERE) * mass / (len(off) if weight is None else float(weight.sum())) * foreseen
    share = here / (here + _ANYWHERE / paths.area_px2)
    gain = variance * np.linalg.inv(both)
    step = gain @ middle
    left = variance * (1.0 - share * np.trace(gain) / 2.0)
    among = share * (1.0 - share) * float(step @ step) / 2.0
    return MapPixel(*map(float, at + share * step)), float(left + among)


def on_paths(answer: Answer, paths: Paths, *, weight: Array | None = None) -> Answer:
    """Join each position that was computed with where cameras are, and state its radius anew.

    Parameters
    ----------
    answer : Answer
    paths : Paths
    weight : (n,) float64, optional
        As for `drawn`.
    """
    hypotheses = tuple(_on_paths(h, paths, weight) for h in answer.hypotheses)
    return replace(answer, hypotheses=hypotheses)


def _on_paths(hypothesis: Hypothesis, paths: Paths, weight: Array | None) -> Hypothesis:
    if hypothesis.kind == "photo" or hypothesis.radius_px is None:
        return hypothesis
    least = _ERR_TOGETHER * paths.place_radius_px
    known = (hypothesis.radius_px**2 + least**2) / INSIDE_68**2
    position, variance = drawn(hypothesis.position, known, paths=paths, weight=weight)
    radius = min(INSIDE_68 * math.sqrt(variance), paths.place_radius_px)
    return replace(hypothesis, position=position, radius_px=radius)
