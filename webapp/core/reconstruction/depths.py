"""Depths of the keypoints of oriented photos, by triangulation.

Each pair of photos with a match gives the depth of the keypoint in both. The observations of a keypoint are
fused by inverse variance, but the result is not considered more certain than the best of them: their errors
are correlated by the positions of the photos. Inverse depths have nearly Gaussian errors (Civera, Davison,
Montiel, "Inverse Depth Parametrization for Monocular SLAM", 2008).

The Sampson error is that of the epipolar constraint between pairs of cameras, at depth 1: the first-order
distance of a match from satisfying the constraint (Sampson 1982; Hartley and Zisserman, "Multiple View
Geometry", 2004, 11.4.3). `core/localize/pose_refinement.py` computes it for many poses of one
camera at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.extrinsics import MIN_TRUST, KeypointDepths, MapExtrinsics, empty_depths
from webapp.core.reconstruction.pairs import PhotoPairs, homogeneous
from webapp.core.tuning import DEFAULT, ExtrinsicsTuning


@dataclass(frozen=True, slots=True, eq=False)
class SampsonError:
    """Residuals of m matches and their derivatives."""

    value: Array  # (m,) float64. Sampson error, in the unit of rays at depth 1.
    sigma: Array  # (m,) float64. Standard deviation of `value` for a right match.
    # `d_first`, `d_second`: (m, 3) float64. Derivatives by world rotations of the first and the second
    # camera, radians.
    d_first: Array
    d_second: Array
    # (m,) float64. Derivative by the second camera's height (down), in units of the baseline.
    d_height: Array


def sampson_error(
    a: Array, b: Array, *, baseline: Array, cameras: tuple[Array, Array], sigmas: tuple[Array, Array]
) -> SampsonError:
    """Compute Sampson errors of m matches.

    Args:
        a, b: (m, 3) float64. Rays in the world, of depth 1 in their cameras.
        baseline: (m, 3) float64. Unit vectors from the first camera to the second.
        cameras: two (m, 3, 3) float64. Camera from world.
        sigmas: two (m,) float64. Standard deviations of the rays at depth 1.
    """
    b_baseline, baseline_a, a_b = np.cross(b, baseline), np.cross(baseline, a), np.cross(a, b)
    in_first = (np.einsum("mij,mj->mi", cameras[0], b_baseline)[:, :2] ** 2).sum(1)
    in_second = (np.einsum("mij,mj->mi", cameras[1], baseline_a)[:, :2] ** 2).sum(1)
    gradient = np.sqrt(in_first + in_second) + 1e-9
    return SampsonError(
        value=(a * b_baseline).sum(1) / gradient,
        sigma=np.sqrt(sigmas[0] ** 2 * in_first + sigmas[1] ** 2 * in_second + 1e-18) / gradient,
        d_first=np.cross(a, b_baseline) / gradient[:, None],
        d_second=np.cross(b, baseline_a) / gradient[:, None],
        d_height=a_b[:, 1] / gradient,
    )


Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DepthObservations:
    """Observations of keypoint depths by pairs of photos; s of them."""

    # `photo`, `row`: (s,) int32. The keypoint, in ascending order.
    photo: NDArray[np.int32]
    row: NDArray[np.int32]
    partner: NDArray[np.int32]  # (s,) int32. The other photo of the pair.
    # `inverse_depth`, `sigma`: (s,) float64. Inverse depth, per map pixel, and its standard deviation.
    inverse_depth: Array
    sigma: Array

    def fuse(self) -> KeypointDepths:
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
        """Select observations by a numpy index."""
        return DepthObservations(
            self.photo[which],
            self.row[which],
            self.partner[which],
            self.inverse_depth[which],
            self.sigma[which],
        )


@dataclass(frozen=True, slots=True, eq=False)
class DepthsExcluding:
    """Depths without observations from hidden photos, averaged on lookup.

    The orientations by which they were triangulated still depend on the hidden photos.
    """

    observations: DepthObservations
    hidden: NDArray[np.bool_]  # (p,) bool

    def lookup(self, photo: int, row: NDArray[np.int64]) -> tuple[Array, Array]:
        """Look up inverse depths of a photo's keypoints (m,) and their sigmas (m,); NaN where unknown."""
        first, stop = np.searchsorted(self.observations.photo, [photo, photo + 1])
        there = self.observations.subset(slice(int(first), int(stop)))
        left = ~(self.hidden[there.photo] | self.hidden[there.partner])
        return there.subset(left).fuse().lookup(photo, row)


def triangulate_depths(
    pairs: PhotoPairs,
    position: Array,
    *,
    extrinsics: MapExtrinsics,
    ray_sigma: Array,
    place_radius_px: float,
    tuning: ExtrinsicsTuning = DEFAULT.extrinsics,
) -> DepthObservations:
    """Triangulate the inliers of each pair.

    Args:
        position: (p, 2) float64. Map pixels.
        extrinsics: Of the p photos; its depths are not used.
        ray_sigma: (p,) float64. Standard deviation of a keypoint of each photo, at depth 1.
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    world = extrinsics.centres(position)
    gap = world[second] - world[first]
    usable = extrinsics.trust >= MIN_TRUST
    both = np.flatnonzero(usable[first] & usable[second] & (gap[:, [0, 2]] != 0.0).any(1))
    first, second, gap = first[both], second[both], gap[both]
    cameras = (extrinsics.rotation[first], extrinsics.rotation[second])
    sigmas = (ray_sigma[first], ray_sigma[second])
    one = np.einsum("mji,mj->mi", cameras[0], homogeneous(pairs.ray_first[both]))
    two = np.einsum("mji,mj->mi", cameras[1], homogeneous(pairs.ray_second[both]))
    depth, sine = _triangulate(one, two, gap)
    unit = gap / np.linalg.norm(gap, axis=1)[:, None]
    error = sampson_error(one, two, baseline=unit, cameras=cameras, sigmas=sigmas)
    kept = np.flatnonzero(
        (np.abs(error.value) <= tuning.depth_inlier_sigmas * error.sigma)
        & (depth > 0.0).all(0)
        & (sine >= math.sin(math.radians(tuning.min_angle_deg)))
    )
    position_sigma = math.sqrt(2.0) * tuning.position_sigma * place_radius_px
    sigma = [
        _inverse_depth_sigma(
            ray[kept],
            gap[kept],
            depths=(depth[i, kept], depth[1 - i, kept]),
            sigmas=(sigmas[i][kept], sigmas[1 - i][kept]),
            position_sigma_px=position_sigma,
        )
        for i, ray in enumerate((one, two))
    ]
    return _without_duplicates(
        DepthObservations(
            photo=np.concatenate([first[kept], second[kept]]).astype(np.int32),
            row=np.concatenate([pairs.row_first[both][kept], pairs.row_second[both][kept]]),
            partner=np.concatenate([second[kept], first[kept]]).astype(np.int32),
            inverse_depth=1.0 / depth[:, kept].ravel(),
            sigma=np.concatenate(sigma),
        )
    )


def _triangulate(one: Array, two: Array, gap: Array) -> tuple[Array, Array]:
    """Intersect the rays (m, 3) of m matches, with baselines `gap` (m, 3), all in the world.

    Returns:
        depth: (2, m) float64. In each camera, map pixels; negative behind it.
        sine: (m,) float64. Of the angle between the rays.
    """
    normal = np.cross(one, two)
    squared = np.maximum((normal**2).sum(1), 1e-12)
    depth = np.stack([(np.cross(gap, ray) * normal).sum(1) / squared for ray in (two, one)])
    return depth, np.sqrt(squared / ((one**2).sum(1) * (two**2).sum(1)))


def _inverse_depth_sigma(
    ray: Array,
    gap: Array,
    *,
    depths: tuple[Array, Array],
    sigmas: tuple[Array, Array],
    position_sigma_px: float,
) -> Array:
    """Propagate the noise of keypoints and positions to inverse depths (m,).

    Noise of a ray, times its depth, moves the intersection along the other ray, in inverse proportion to the
    part of the baseline across that ray. A relative error of the baseline is also a relative error of all
    depths of the pair.

    Args:
        ray: (m, 3) float64. Rays of the photo whose depths these are, in the world.
        gap: (m, 3) float64
        depths, sigmas: two (m,) float64. Depths, map pixels, and standard deviations of the rays, in this
            photo and in its partner.
        position_sigma_px: Standard deviation of the distance of two photos on the map.
    """
    across = np.linalg.norm(np.cross(gap, ray), axis=1) / np.linalg.norm(ray, axis=1)
    own, other = depths
    ratio = other / own
    by_noise = ratio * np.hypot(sigmas[0], ratio * sigmas[1]) / np.maximum(across, 1e-6)
    sigma: Array = np.hypot(by_noise, position_sigma_px / np.linalg.norm(gap, axis=1) / own)
    return sigma


def _without_duplicates(found: DepthObservations) -> DepthObservations:
    """Sort observations, and keep the most certain one of each keypoint with each partner."""
    order = np.lexsort((found.sigma, found.partner, found.row, found.photo))
    keys = np.stack([found.photo, found.row, found.partner])[:, order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (np.diff(keys, axis=1) != 0).any(0)
    return found.subset(order[new])
