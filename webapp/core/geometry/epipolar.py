"""How far matches are from meeting: Sampson's distance of the epipolar constraint, at depth 1.

`core/localize/pose_residuals.py` has the same for many poses at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SampsonError:
    """Of m matches.

    Attributes
    ----------
    value : (m,) float64
        Sampson's distance.
    d_first, d_second : (m, 3) float64
        Its derivatives by turns of the first and the second camera in the world.
    d_height : (m,) float64
        By the second camera's way down, over the distance of the cameras.
    """

    value: Array
    d_first: Array
    d_second: Array
    d_height: Array


def sampson_error(a: Array, b: Array, *, along: Array, cameras: tuple[Array, Array]) -> SampsonError:
    """Compare the rays of matches with the directions between their cameras.

    Parameters
    ----------
    a, b : (m, 3) float64
        In the world, of depth 1 in their cameras.
    along : (m, 3) float64
        From the first camera to the second, of length 1.
    cameras : two (m, 3, 3) float64
        Camera from world.
    """
    b_along, along_a, a_b = np.cross(b, along), np.cross(along, a), np.cross(a, b)
    in_first = np.einsum("mij,mj->mi", cameras[0], b_along)[:, :2]
    in_second = np.einsum("mij,mj->mi", cameras[1], along_a)[:, :2]
    size = np.sqrt((in_first**2).sum(1) + (in_second**2).sum(1)) + 1e-9
    return SampsonError(
        value=(a * b_along).sum(1) / size,
        d_first=np.cross(a, b_along) / size[:, None],
        d_second=np.cross(b, along_a) / size[:, None],
        d_height=a_b[:, 1] / size,
    )
