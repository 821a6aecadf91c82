"""Records of a robot: the poses of tracks, and detected objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.types import LatLon
from webapp.core.landmarks.radii import RADIUS_OVER_SIGMA
from webapp.robot.fields import SOURCES, Source

__all__ = ["SOURCES", "Poses", "Sighting", "Source", "covariance_radius_m", "join", "make_poses"]


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """The poses of one track, in the order in which they arrived."""

    times_s: NDArray[np.float64]  # (n,) float64. Seconds since 1970, UTC; not necessarily ascending.
    latlon: NDArray[np.float64]  # (n, 2) float64. Degrees north, degrees east.
    # (n,) float64. Metres, in the height system of the source; NaN where it is unknown.
    height_m: NDArray[np.float64]
    # (n,) float64. Degrees clockwise from north, 0 <= heading < 360; NaN where it is unknown.
    heading_deg: NDArray[np.float64]
    # (n, 3) float64. Square metres: variance east, variance north, covariance of the two; NaN where it is
    # unknown.
    covariance_m2: NDArray[np.float64]
    # (n,) float64. Metres along the track since its first pose, through the poses that thinning left out too.
    travelled_m: NDArray[np.float64]

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.times_s)

    def take(self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Poses:
        """Return some of the poses, by a slice, a mask (n,) bool, or indices (m,) intp."""
        return Poses(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True, slots=True)
class Sighting:
    """A detection of an object by a robot."""

    # The same at every sighting of an object; None if its detector does not track objects.
    object_id: str | None
    kind: str  # Its class: `car`, `victim` ..
    time_s: float  # Seconds since 1970, UTC
    latlon: LatLon
    height_m: float | None = None
    confidence: float | None = None  # 0 to 1
    photo: str | None = None  # SHA-256 of a photo of the mission, hexadecimal
    # Of the position: variance east, variance north, covariance of the two.
    covariance_m2: tuple[float, float, float] | None = None
    size_m: tuple[float, float, float] | None = None  # Along the object's own axes, the last one up
    state: str = ""  # The object's state, read from a file that this program exported; empty if it has none


def covariance_radius_m(covariance_m2: Sequence[float] | None) -> float | None:
    """Return the radius that holds 68 %, metres; None if the covariance is unknown."""
    if covariance_m2 is None or math.isnan(covariance_m2[0]):
        return None
    return RADIUS_OVER_SIGMA * math.sqrt((covariance_m2[0] + covariance_m2[1]) / 2.0)


def make_poses(
    times_s: ArrayLike,
    latlon: ArrayLike,
    *,
    height_m: ArrayLike | None = None,
    heading_deg: ArrayLike | None = None,
    covariance_m2: ArrayLike | None = None,
    travelled_m: ArrayLike | None = None,
) -> Poses:
    """Make poses from arrays; those not given are NaN.

    Args:
        times_s: (n,) array_like
        latlon: (n, 2) array_like
        height_m, heading_deg: (n,) array_like. Headings are normalised to 0 <= heading < 360.
        covariance_m2: (n, 3) array_like
        travelled_m: (n,) array_like

    Raises:
        ValueError: The arrays differ in length.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    n = len(times)

    def column(values: ArrayLike | None, *shape: int) -> NDArray[np.float64]:
        if values is None:
            return np.full((n, *shape), np.nan)
        array = np.asarray(values, dtype=np.float64)
        return array.reshape(n, *shape)

    heading = column(heading_deg) % 360.0
    heading[heading == 360.0] = 0.0  # the remainder of a tiny negative number rounds up to the divisor
    return Poses(
        times,
        column(latlon, 2),
        column(height_m),
        heading,
        column(covariance_m2, 3),
        column(travelled_m),
    )


def join(parts: Sequence[Poses]) -> Poses:
    """Concatenate poses; `travelled_m` is not changed."""
    if not parts:
        return make_poses([], np.empty((0, 2)))
    return Poses(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Poses)))
