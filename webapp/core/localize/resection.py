"""Position and heading from bearings to photos of known position (resection).

Each verified photo gives the direction from the query to its camera, relative to the query's viewing
direction. Three such bearings fix position and heading; more make the solution robust. Positions are scored
on a grid around the photos, coarse first, so that separate solutions stay separate hypotheses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_BEARINGS = 3
"""Fewer do not determine a position."""

_SIGMA_BEARING = 0.25
"""Standard deviation of a usable bearing, radians."""

_FULL_PARALLAX = math.radians(2.0)
"""From this parallax on a bearing counts fully; with less, its photo rather indicates nearness only."""

_NEAR = 3.0
"""Scale of the decay of a photo's weight with its distance, place radii."""

_FARTHEST = math.exp(-4.0 / 3.0)
"""Minimum nearness of a photo that can support a place: that at four place radii."""

_HEADINGS_TRIED = 6
_COARSE, _REACH = 0.25, 1.5
"""Grid step and half width around each photo, place radii."""

_LIKELIHOOD = 4.0
"""Log-likelihood of one fully trusted photo that agrees."""

_FLOOR = 1e-3
"""Added to the relative density of photos, for queries taken away from all of them."""

_REACHED_BY_DENSITY = 4.0
"""Photos farther than this, place radii, are ignored in the density."""

_APART = 2.0

_LEAST_SHARE = 0.1
"""Minimum score of a separate solution, over that of the best one."""

_REFINEMENTS = 2

_FINE = 13
"""Points per side of the grid of the final estimate, which extends a place radius around each solution."""


@dataclass(frozen=True, slots=True, eq=False)
class Bearings:
    """Bearings from the query to n verified photos."""

    position: NDArray[np.float64]  # (n, 2) float64. Positions of the photos, map pixels.
    bearing: NDArray[np.float64]  # (n,) float64. Radians clockwise from the query's viewing direction.
    parallax: NDArray[np.float64]  # (n,) float64. Radians.
    weight: NDArray[np.float64]  # (n,) float64. Trust in each, 0 to 1.


@dataclass(frozen=True, slots=True, eq=False)
class Resection:
    """A position that explains the bearings."""

    # `x`, `y`: Map pixels.
    x: float
    y: float
    heading: float  # Radians clockwise from up
    score: float  # Sum of the weights of the photos that agree
    agreement: NDArray[np.float64]  # (n,) float64. Agreement of each photo, 0 to 1.
    sigma_px: float  # Root mean square distance of the posterior from the position, map pixels


def resect(
    bearings: Bearings, taken_at: NDArray[np.float64], *, place_radius_px: float, most: int
) -> list[Resection]:
    """Find the positions that explain the bearings best.

    Args:
        taken_at: (p, 2) float64. Positions of the map's photos, map pixels: prior for where queries are
            taken.
        place_radius_px: Scale of the search; solutions nearer to each other than twice this are one, so that
            the truth is within the radius of only one of them.
        most: Maximum number of solutions.

    Returns:
        The best first; empty without bearings.
    """
    if not len(bearings.position):
        return []
    offsets = _square(np.arange(-_REACH, _REACH + 1e-9, _COARSE) * place_radius_px)
    seeds = np.unique(bearings.position, axis=0)
    grid = np.unique(np.round(np.concatenate([seed + offsets for seed in seeds]), 3), axis=0)
    score, _ = _score(bearings, grid, place_radius_px)
    solutions: list[Resection] = []
    while len(solutions) < most and len(grid):
        best = int(score.argmax())
        if solutions and score[best] < _LEAST_SHARE * solutions[0].score:
            break
        solution = _posterior_mean(bearings, taken_at, grid[best], place_radius_px=place_radius_px)
        if all(math.hypot(solution.x - s.x, solution.y - s.y) > _APART * place_radius_px for s in solutions):
            solutions.append(solution)
        apart = np.hypot(*(grid - grid[best]).T) > _APART * place_radius_px
        grid, score = grid[apart], score[apart]
    return sorted(solutions, key=lambda s: -s.score)


def _posterior_mean(
    bearings: Bearings, taken_at: NDArray[np.float64], centre: NDArray[np.float64], *, place_radius_px: float
) -> Resection:
    """Average the positions around a solution by their posterior, whose spread is the uncertainty."""
    step = _COARSE * place_radius_px
    for _ in range(_REFINEMENTS):
        closer = centre + _square(np.linspace(-step, step, 5))
        centre = closer[_score(bearings, closer, place_radius_px)[0].argmax()]
        step /= 2.5
    around = centre + _square(np.linspace(-1.0, 1.0, _FINE) * place_radius_px)
    score, heading = _score(bearings, around, place_radius_px)
    posterior = _LIKELIHOOD * score + np.log(_density(around, taken_at, place_radius_px) + _FLOOR)
    weight = np.exp(posterior - posterior.max())
    weight /= weight.sum()
    mean = weight @ around
    turned = float(np.angle((weight * np.exp(1j * heading)).sum()))
    return Resection(
        x=float(mean[0]),
        y=float(mean[1]),
        heading=turned % (2.0 * math.pi),
        score=float(score.max()),
        agreement=_agreement(
            bearings,
            around[int(score.argmax())],
            float(heading[score.argmax()]),
            place_radius_px=place_radius_px,
        ),
        sigma_px=math.sqrt(float(weight @ ((around - mean) ** 2).sum(1))),
    )


def _density(
    position: NDArray[np.float64], taken_at: NDArray[np.float64], place_radius_px: float
) -> NDArray[np.float64]:
    """Compute the relative density of photos at (g, 2) positions, smoothed over half a place radius."""
    apart = np.hypot(*(taken_at - position.mean(0)).T)
    near = np.unique(taken_at[apart <= _REACHED_BY_DENSITY * place_radius_px], axis=0)
    if not len(near):
        return np.zeros(len(position))
    squared = ((position[:, None] - near[None]) ** 2).sum(-1)
    density: NDArray[np.float64] = np.exp(-2.0 * squared / place_radius_px**2).mean(1)
    return density


def _square(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)


def _agreement(
    bearings: Bearings, position: NDArray[np.float64], heading: float, *, place_radius_px: float
) -> NDArray[np.float64]:
    """Compute the agreement of each photo with a position and a heading, 0 to 1; (n,)."""
    near, implied, reliable = _geometry(bearings, position[None], place_radius_px)
    agrees: NDArray[np.float64] = 1.0 - reliable + reliable * _kernel(implied[0] - heading)
    agrees[near[0] < _FARTHEST] = 0.0
    return agrees


def _geometry(
    bearings: Bearings, position: NDArray[np.float64], place_radius_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return nearness (g, n) and implied heading (g, n) of (g, 2) positions, and bearing reliability (n,)."""
    to_photo = bearings.position[None] - position[:, None]
    near = np.exp(-np.hypot(to_photo[..., 0], to_photo[..., 1]) / (_NEAR * place_radius_px))
    implied = np.arctan2(to_photo[..., 0], -to_photo[..., 1]) - bearings.bearing
    return near, implied, np.minimum(bearings.parallax / _FULL_PARALLAX, 1.0)


def _kernel(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute a robust (Geman-McClure) weight of angles, 1 to 0."""
    apart = np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
    agree: NDArray[np.float64] = 1.0 / (1.0 + (apart / _SIGMA_BEARING) ** 2) ** 2
    return agree


def _score(
    bearings: Bearings, position: NDArray[np.float64], place_radius_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Score (g, 2) positions; returns the scores and the best heading at each, radians."""
    near, implied, reliable = _geometry(bearings, position, place_radius_px)
    trust = bearings.weight * near
    base = (trust * (1.0 - reliable)).sum(1)
    best = np.full(len(position), -np.inf)
    heading = np.zeros(len(position))
    for j in np.argsort(-bearings.weight * reliable)[:_HEADINGS_TRIED]:
        total = base + (trust * reliable * _kernel(implied - implied[:, j : j + 1])).sum(1)
        better = total > best
        best = np.where(better, total, best)
        heading = np.where(better, implied[:, j], heading)
    return best, heading
