"""Depths of what oriented photos see in common, by where their rays meet (triangulation).

Each pair of photos that shows a point tells its depth in both; several pairs are averaged, and what they
disagree by counts as uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.reconstruction.pairs import Pairs, homogeneous
from webapp.core.reconstruction.types import USABLE_TRUST, Depths, Orientations, no_depths

Array = NDArray[np.float64]

_TOLERANCE = 2.0 / 450.0
"""Rays farther apart than this, at depth 1 (Sampson's distance), do not meet."""

_NOISE = 1.5 / 450.0
_LEAST_ANGLE = math.radians(1.0)
_RELATIVE_ERROR = 0.05
"""Of every depth, because positions on a map are not exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """What pairs of photos say of the depths of their keypoints; s of them.

    Attributes
    ----------
    photo, row : (s,) int32
        The keypoint, in rising order.
    partner : (s,) int32
        The other photo of the pair.
    inverse, spread : (s,) float64
        Inverse depth, per map pixel, and how uncertain it is.
    """

    photo: NDArray[np.int32]
    row: NDArray[np.int32]
    partner: NDArray[np.int32]
    inverse: Array
    spread: Array

    def averaged(self) -> Depths:
        """Average what is known of each keypoint."""
        return _averaged(self.photo, self.row, inverse=self.inverse, spread=self.spread)

    def without(self, hidden: NDArray[np.bool_]) -> Depths:
        """Average as if (p,) `hidden` photos had never been there."""
        left = ~(hidden[self.photo] | hidden[self.partner])
        return _averaged(
            self.photo[left], self.row[left], inverse=self.inverse[left], spread=self.spread[left]
        )


def sightings_of(pairs: Pairs, position: Array, *, orientations: Orientations) -> Sightings:
    """Find the depths of keypoints by each pair that shows them.

    Parameters
    ----------
    pairs : Pairs
    position : (p, 2) float64
        Map pixels.
    orientations : Orientations
        Of the p photos; their depths do not count.

    Returns
    -------
    Sightings
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    world = np.column_stack([position[:, 0], orientations.height, -position[:, 1]])
    gap = world[second] - world[first]
    usable = orientations.trust >= USABLE_TRUST
    both = np.flatnonzero(usable[first] & usable[second] & (np.linalg.norm(gap, axis=1) > 0.0))
    first, second, gap = first[both], second[both], gap[both]
    one = np.einsum("mji,mj->mi", orientations.rotation[first], homogeneous(pairs.ray_first[both]))
    two = np.einsum("mji,mj->mi", orientations.rotation[second], homogeneous(pairs.ray_second[both]))
    depth, meet = _where_rays_meet(
        one, two, gap, first=orientations.rotation[first], second=orientations.rotation[second]
    )
    kept = np.flatnonzero(meet)
    photo = np.concatenate([first[kept], second[kept]])
    row = np.concatenate([pairs.row_first[both][kept], pairs.row_second[both][kept]])
    order = np.lexsort((row, photo))
    return Sightings(
        photo=photo[order].astype(np.int32),
        row=row[order],
        partner=np.concatenate([second[kept], first[kept]])[order].astype(np.int32),
        inverse=1.0 / depth[:, kept].ravel()[order],
        spread=np.concatenate([_spread(ray[kept], gap[kept]) for ray in (one, two)])[order],
    )


def _where_rays_meet(
    one: Array, two: Array, gap: Array, *, first: Array, second: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate m matches from their rays in the world; returns (2, m) depths, and which are to be used.

    Parameters
    ----------
    one, two : (m, 3) float64
        Of depth 1 in their cameras.
    gap : (m, 3) float64
        From the first camera to the second.
    first, second : (m, 3, 3) float64
        The cameras' rotations.
    """
    one_two = np.cross(one, two)
    squared = np.maximum((one_two**2).sum(1), 1e-12)
    depth = np.stack([(np.cross(gap, ray) * one_two).sum(1) / squared for ray in (two, one)])
    along = gap / np.linalg.norm(gap, axis=1)[:, None]
    two_along, along_one = np.cross(two, along), np.cross(along, one)
    in_first = np.einsum("mij,mj->mi", first, two_along)[:, :2]
    in_second = np.einsum("mij,mj->mi", second, along_one)[:, :2]
    off = (one * two_along).sum(1) / np.sqrt((in_first**2).sum(1) + (in_second**2).sum(1) + 1e-18)
    sine = np.sqrt(squared / ((one**2).sum(1) * (two**2).sum(1)))
    use = (np.abs(off) <= _TOLERANCE) & (depth > 0.0).all(0) & (sine >= math.sin(_LEAST_ANGLE))
    return depth, use


def _spread(ray: Array, gap: Array) -> Array:
    """Tell how uncertain inverse depths are (m,): the wider the base across the ray, the less."""
    across = np.linalg.norm(np.cross(gap, ray), axis=1) / np.linalg.norm(ray, axis=1)
    uncertain: Array = _NOISE / np.maximum(across, 1e-6)
    return uncertain


def _averaged(photo: NDArray[np.int32], row: NDArray[np.int32], *, inverse: Array, spread: Array) -> Depths:
    """Average all that is known of each keypoint; they are in order."""
    if not len(photo):
        return no_depths()
    new = np.ones(len(photo), np.bool_)
    new[1:] = (np.diff(photo) != 0) | (np.diff(row) != 0)
    start, keypoint, weight = np.flatnonzero(new), np.cumsum(new) - 1, spread**-2
    total = np.add.reduceat(weight, start)
    mean = np.add.reduceat(weight * inverse, start) / total
    disagreement = np.add.reduceat(weight * (inverse - mean[keypoint]) ** 2, start) / total
    uncertain = np.sqrt(1.0 / total + disagreement + (_RELATIVE_ERROR * mean) ** 2)
    return Depths(photo[start], row[start], mean.astype(np.float32), uncertain.astype(np.float32))
