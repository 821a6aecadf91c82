"""Position and heading from bearings to photos whose places are known (resection).

Each verified photo tells in which direction from the query's own viewing direction its camera stood. Three
such bearings fix position and heading; more make it robust. The score of a position is searched on a grid
around the photos, coarse first, so that separate solutions stay separate hypotheses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_BEARINGS = 3
"""Fewer leave a position open."""

_SIGMA_BEARING = 0.25
"""Spread of a usable bearing, radians."""

_FULL_PARALLAX = math.radians(2.0)
"""From this parallax on a bearing counts fully; below, its photo only says "near"."""

_NEAR = 2.0
"""How fast a photo's say fades with its distance, in place radii."""

_HEADINGS_TRIED = 6
_COARSE, _REACH = 0.25, 1.5
"""Grid step and half width around each photo, in place radii."""

_REFINEMENTS = 3
_SPREAD_LEVEL = 0.9
"""Positions that score this share of the best are still plausible: their spread is the uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class Bearings:
    """What the verified photos say.

    Attributes
    ----------
    position : (n, 2) float64
        Of the photos, map pixels.
    bearing : (n,) float64
        Radians clockwise from the query's viewing direction.
    parallax : (n,) float64
        Radians.
    weight : (n,) float64
        Trust in each, 0 to 1.
    """

    position: NDArray[np.float64]
    bearing: NDArray[np.float64]
    parallax: NDArray[np.float64]
    weight: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Fix:
    """A position that explains the bearings.

    Attributes
    ----------
    x, y : float
        Map pixels.
    heading : float
        Radians clockwise from up.
    score : float
        Sum of the weights of the photos that agree.
    spread_px : float
        Root mean square distance of the plausible positions from it, map pixels.
    """

    x: float
    y: float
    heading: float
    score: float
    spread_px: float


def resect(bearings: Bearings, place_radius_px: float, *, most: int) -> list[Fix]:
    """Find the positions that explain the bearings best.

    Parameters
    ----------
    bearings : Bearings
    place_radius_px : float
        Scale of the search; solutions nearer to each other than this are one.
    most : int
        At most so many solutions.

    Returns
    -------
    list of Fix
        The best first; empty without bearings.
    """
    if not len(bearings.position):
        return []
    offsets = _square(np.arange(-_REACH, _REACH + 1e-9, _COARSE) * place_radius_px)
    seeds = np.unique(bearings.position, axis=0)
    grid = np.unique(np.round(np.concatenate([seed + offsets for seed in seeds]), 3), axis=0)
    score, _ = _score(bearings, grid, place_radius_px)
    fixes: list[Fix] = []
    while len(fixes) < most and len(grid):
        best = int(score.argmax())
        fix = _refine(bearings, grid[best], place_radius_px)
        fixes.append(fix)
        apart = np.hypot(*(grid - grid[best]).T) > place_radius_px
        grid, score = grid[apart], score[apart]
    return sorted(fixes, key=lambda f: -f.score)


def _refine(bearings: Bearings, start: NDArray[np.float64], place_radius_px: float) -> Fix:
    """Search finer and finer around a point of the grid."""
    centre, step = start, _COARSE * place_radius_px
    for _ in range(_REFINEMENTS):
        around = centre + _square(np.linspace(-step, step, 5))
        score, heading = _score(bearings, around, place_radius_px)
        best = int(score.argmax())
        centre, step = around[best], step / 2.5
    wide = centre + _square(np.linspace(-1.0, 1.0, 9) * place_radius_px)
    plausible, _ = _score(bearings, wide, place_radius_px)
    weight = np.maximum(plausible / max(score[best], 1e-12) - _SPREAD_LEVEL, 0.0)
    weight[len(wide) // 2] = max(weight[len(wide) // 2], 1e-6)
    spread = math.sqrt(float((weight * ((wide - centre) ** 2).sum(1)).sum() / weight.sum()))
    return Fix(
        x=float(centre[0]),
        y=float(centre[1]),
        heading=float(heading[best]) % (2.0 * math.pi),
        score=float(score[best]),
        spread_px=max(spread, step),
    )


def _square(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)


def _score(
    bearings: Bearings, position: NDArray[np.float64], place_radius_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Score (g, 2) positions; returns the scores and the best heading of each, radians."""
    to_photo = bearings.position[None] - position[:, None]
    distance = np.hypot(to_photo[..., 0], to_photo[..., 1])
    azimuth = np.arctan2(to_photo[..., 0], -to_photo[..., 1])
    implied = azimuth - bearings.bearing
    trust = bearings.weight * np.exp(-distance / (_NEAR * place_radius_px))
    reliable = np.minimum(bearings.parallax / _FULL_PARALLAX, 1.0)
    base = (trust * (1.0 - reliable)).sum(1)
    best = np.full(len(position), -np.inf)
    heading = np.zeros(len(position))
    for j in np.argsort(-bearings.weight * reliable)[:_HEADINGS_TRIED]:
        apart = np.remainder(implied - implied[:, j : j + 1] + math.pi, 2.0 * math.pi) - math.pi
        agree = 1.0 / (1.0 + (apart / _SIGMA_BEARING) ** 2) ** 2
        total = base + (trust * reliable * agree).sum(1)
        better = total > best
        best = np.where(better, total, best)
        heading = np.where(better, implied[:, j], heading)
    return best, heading
