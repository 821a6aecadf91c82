"""Heights of cameras relative to each other, from the altitudes in the metadata of their photos.

Only differences within a flight count: a drone measures its height above the start by air pressure, whose
zero drifts from flight to flight; the altitude by GPS is off by the same few metres for all photos of an
hour. What the differences say is weighed against what is expected without them, that cameras are at about
one height (empirical Bayes): altitudes that scatter as much as they are inaccurate say nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BY_PRESSURE_M, _BY_GPS_M = 1.5, 10.0
"""Standard deviations of a height above the start, with the drift during a flight, and by GPS."""

_ANOTHER_START_M = 1.0
"""Least gap, between photos, of the altitude of the start: further ones are of another flight."""

_FAR = 5.0
"""Distance from the median, in standard deviations, from which on an altitude by GPS is wrong: often 0."""

_LEAST = 2
"""Photos of a flight of which the differences are known."""


@dataclass(frozen=True, slots=True)
class Altitude:
    """What the file of a photo says about its height, metres; None where it says nothing."""

    above_sea_m: float | None = None
    above_start_m: float | None = None  # Above where a drone has started


@dataclass(frozen=True, slots=True, eq=False)
class CameraHeights:
    """Heights of n cameras relative to the mean of their flight, map pixels.

    The level of a flight is unknown: a map has no zero of heights.
    """

    height_px: Array  # (n,) float64. NaN where unknown.
    sigma_px: Array  # (n,) float64
    flight: NDArray[np.int64]  # (n,) int64. Number of the flight; -1 where the height is unknown.

    def subset(self, rows: NDArray[np.int64]) -> CameraHeights:
        """Return those of some cameras, in the order of `rows`."""
        return CameraHeights(self.height_px[rows], self.sigma_px[rows], self.flight[rows])


@dataclass(frozen=True, slots=True)
class Altitudes:
    """The altitudes of n photos, and the scale of their map."""

    photos: tuple[Altitude, ...]
    px_per_m: float  # Map pixels per metre

    def subset(self, rows: Iterable[int]) -> Altitudes:
        """Return those of some photos, in the order of `rows`."""
        return Altitudes(tuple(self.photos[row] for row in rows), self.px_per_m)

    def heights(self, *, usual_px: float) -> CameraHeights:
        """Compute the heights of the cameras.

        Args:
            usual_px: Standard deviation of the heights where nothing is known about them.
        """
        nothing = np.full(len(self.photos), np.nan)
        found = CameraHeights(nothing, nothing.copy(), np.full(len(nothing), -1, np.int64))
        for flight, (rows, height_m, sigma_m) in enumerate(_flights(self.photos)):
            off, sigma = self.px_per_m * (height_m - height_m.mean()), self.px_per_m * sigma_m
            spread = max(usual_px**2, float(off.var()) - sigma**2)
            share = spread / (spread + sigma**2)
            found.height_px[rows], found.sigma_px[rows] = share * off, np.sqrt(share) * sigma
            found.flight[rows] = flight
        return found


def _flights(altitudes: Sequence[Altitude]) -> Iterator[tuple[NDArray[np.int64], Array, float]]:
    """Yield the rows, the heights in metres and their standard deviation for each flight, and for all photos
    with an altitude by GPS alone."""
    table = np.array([(one.above_sea_m, one.above_start_m) for one in altitudes], np.float64).reshape(-1, 2)
    by_pressure = np.isfinite(table[:, 1])
    for rows in _of_one_start(np.flatnonzero(by_pressure), table[:, 0] - table[:, 1]):
        if len(rows) >= _LEAST:
            yield rows, table[rows, 1], _BY_PRESSURE_M
    rows = np.flatnonzero(~by_pressure & np.isfinite(table[:, 0]))
    if len(rows) >= _LEAST:
        off = np.abs(table[rows, 0] - np.median(table[rows, 0]))
        rows = rows[off <= _FAR * max(_BY_GPS_M, 1.4826 * float(np.median(off)))]
    if len(rows) >= _LEAST:
        yield rows, table[rows, 0], _BY_GPS_M


def _of_one_start(rows: NDArray[np.int64], start_m: Array) -> Iterator[NDArray[np.int64]]:
    """Split photos by the altitude of their start; those without it are taken for one flight."""
    known = np.isfinite(start_m[rows])
    if not known.all():
        yield rows[~known]
    rows = rows[known][np.argsort(start_m[rows[known]], kind="stable")]
    gaps = np.flatnonzero(np.diff(start_m[rows]) > _ANOTHER_START_M)
    yield from np.split(rows, gaps + 1)
