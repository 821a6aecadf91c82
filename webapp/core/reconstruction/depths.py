"""Depths of what oriented photos see in common, by where their rays meet (triangulation).

Each pair of photos that shows a point tells its depth in both. What several pairs say of a keypoint is
averaged, but not taken to be surer than the best of them: they err together, by the positions of the photos.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.epipolar import sampson_error
from webapp.core.geometry.extrinsics import MIN_TRUST, KeypointDepths, MapExtrinsics, empty_depths
from webapp.core.reconstruction.pairs import PhotoPairs, homogeneous

Array = NDArray[np.float64]

_TOLERANCE = 2.0 / 450.0
"""Rays farther apart than this, at depth 1, do not meet."""

_NOISE = 1.0 / 450.0
_LEAST_ANGLE = math.radians(1.0)
_POSITION_ERROR = 0.1
"""Of a photo on the map, in place radii: all depths of a pair err by it over their distance."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthObservations:
    """What pairs of photos say of the depths of their keypoints; s of them.

    Attributes
    ----------
    photo, row : (s,) int32
        The keypoint, in rising order.
    partner : (s,) int32
        The other photo of the pair.
    inverse_depth, sigma : (s,) float64
        Inverse depth, per map pixel, and how uncertain it is.
    """

    photo: NDArray[np.int32]
    row: NDArray[np.int32]
    partner: NDArray[np.int32]
    inverse_depth: Array
    sigma: Array

    def fuse(self) -> KeypointDepths:
        """Average what is known of each keypoint."""
        if not len(self.photo):
            return empty_depths()
        new = np.ones(len(self.photo), np.bool_)
        new[1:] = (np.diff(self.photo) != 0) | (np.diff(self.row) != 0)
        start, keypoint, weight = np.flatnonzero(new), np.cumsum(new) - 1, self.sigma**-2
        total = np.add.reduceat(weight, start)
        mean = np.add.reduceat(weight * self.inverse_depth, start) / total
        disagreement = np.add.reduceat(weight * (self.inverse_depth - mean[keypoint]) ** 2, start) / total
        best = np.minimum.reduceat(self.sigma, start)
        uncertain = np.sqrt(best**2 + disagreement)
        return KeypointDepths(
            self.photo[start], self.row[start], mean.astype(np.float32), uncertain.astype(np.float32)
        )

    def subset(self, which: slice | NDArray[np.bool_] | NDArray[np.int64]) -> DepthObservations:
        """Take out some of them, by what numpy takes for an index."""
        return DepthObservations(
            self.photo[which],
            self.row[which],
            self.partner[which],
            self.inverse_depth[which],
            self.sigma[which],
        )


@dataclass(frozen=True, slots=True, eq=False)
class DepthsExcluding:
    """Depths that rest on no sighting of hidden photos, averaged when they are asked for.

    The orientations by which they were worked out still owe something to the hidden photos.

    Attributes
    ----------
    observations : DepthObservations
    hidden : (p,) bool
    """

    observations: DepthObservations
    hidden: NDArray[np.bool_]

    def lookup(self, photo: int, row: NDArray[np.int64]) -> tuple[Array, Array]:
        """Look up inverse depths of a photo's keypoints (m,) and their spreads (m,); NaN where not known."""
        first, stop = np.searchsorted(self.observations.photo, [photo, photo + 1])
        there = self.observations.subset(slice(int(first), int(stop)))
        left = ~(self.hidden[there.photo] | self.hidden[there.partner])
        return there.subset(left).fuse().lookup(photo, row)


def triangulate_depths(
    pairs: PhotoPairs, position: Array, *, extrinsics: MapExtrinsics, place_radius_px: float
) -> DepthObservations:
    """Find the depths of keypoints by each pair that shows them.

    Parameters
    ----------
    pairs : Pairs
    position : (p, 2) float64
        Map pixels.
    extrinsics : MapExtrinsics
        Of the p photos; their depths do not count.
    place_radius_px : float

    Returns
    -------
    Sightings
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    world = extrinsics.centres(position)
    gap = world[second] - world[first]
    usable = extrinsics.trust >= MIN_TRUST
    both = np.flatnonzero(usable[first] & usable[second] & (gap[:, [0, 2]] != 0.0).any(1))
    first, second, gap = first[both], second[both], gap[both]
    cameras = (extrinsics.rotation[first], extrinsics.rotation[second])
    one = np.einsum("mji,mj->mi", cameras[0], homogeneous(pairs.ray_first[both]))
    two = np.einsum("mji,mj->mi", cameras[1], homogeneous(pairs.ray_second[both]))
    depth, meet = _triangulate(one, two, gap, cameras=cameras)
    kept = np.flatnonzero(meet)
    misplaced = math.sqrt(2.0) * _POSITION_ERROR * place_radius_px
    spread = [
        _inverse_depth_sigma(
            ray[kept], gap[kept], own=depth[i, kept], other=depth[1 - i, kept], misplaced_px=misplaced
        )
        for i, ray in enumerate((one, two))
    ]
    return _without_duplicates(
        DepthObservations(
            photo=np.concatenate([first[kept], second[kept]]).astype(np.int32),
            row=np.concatenate([pairs.row_first[both][kept], pairs.row_second[both][kept]]),
            partner=np.concatenate([second[kept], first[kept]]).astype(np.int32),
            inverse_depth=1.0 / depth[:, kept].ravel(),
            sigma=np.concatenate(spread),
        )
    )


def _triangulate(
    one: Array, two: Array, gap: Array, *, cameras: tuple[Array, Array]
) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate m matches from their rays in the world; returns (2, m) depths, and which are to be used.

    Parameters
    ----------
    one, two : (m, 3) float64
        Of depth 1 in their cameras.
    gap : (m, 3) float64
        From the first camera to the second.
    cameras : two (m, 3, 3) float64
        Camera from world.
    """
    one_two = np.cross(one, two)
    squared = np.maximum((one_two**2).sum(1), 1e-12)
    depth = np.stack([(np.cross(gap, ray) * one_two).sum(1) / squared for ray in (two, one)])
    off = sampson_error(one, two, along=gap / np.linalg.norm(gap, axis=1)[:, None], cameras=cameras).value
    sine = np.sqrt(squared / ((one**2).sum(1) * (two**2).sum(1)))
    return depth, (np.abs(off) <= _TOLERANCE) & (depth > 0.0).all(0) & (sine >= math.sin(_LEAST_ANGLE))


def _inverse_depth_sigma(ray: Array, gap: Array, *, own: Array, other: Array, misplaced_px: float) -> Array:
    """Tell how uncertain inverse depths are (m,).

    Noise in an image puts its ray beside the point by the more, the farther away that is, which moves the
    point along the other ray by the more, the shorter the base is across that. And where the photos are
    farther apart than the map says, by some share, all their depths are too small by the same.

    Parameters
    ----------
    ray : (m, 3) float64
        Of the photo whose depths these are, in the world.
    gap : (m, 3) float64
    own, other : (m,) float64
        Depths in this photo and in its partner.
    misplaced_px : float
        How far the distance of two photos on the map is off.
    """
    across = np.linalg.norm(np.cross(gap, ray), axis=1) / np.linalg.norm(ray, axis=1)
    ratio = other / own
    by_noise = _NOISE * ratio * np.hypot(1.0, ratio) / np.maximum(across, 1e-6)
    uncertain: Array = np.hypot(by_noise, misplaced_px / np.linalg.norm(gap, axis=1) / own)
    return uncertain


def _without_duplicates(found: DepthObservations) -> DepthObservations:
    """Put sightings in order; those that both photos of a pair tell of count once, the surer one."""
    order = np.lexsort((found.sigma, found.partner, found.row, found.photo))
    keys = np.stack([found.photo, found.row, found.partner])[:, order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (np.diff(keys, axis=1) != 0).any(0)
    return found.subset(order[new])
