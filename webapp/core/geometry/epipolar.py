"""Sampson error of the epipolar constraint between pairs of cameras, at depth 1.

It is the first-order distance of a match from satisfying the constraint (Sampson 1982; Hartley and Zisserman,
"Multiple View Geometry", 2004, 11.4.3). `core/localize/pose_refinement.py` computes it for many poses of one
camera at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
