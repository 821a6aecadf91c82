"""A recorded track: positions on it by time, and the offset of a camera's clock from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.types import LatLon


@dataclass(frozen=True, slots=True, eq=False)
class FixTrack:
    times_s: NDArray[np.float64]  # (n,) float64. Seconds since 1970, UTC; strictly ascending.
    latlon: NDArray[np.float64]  # (n, 2) float64. Degrees north, degrees east.

    def __len__(self) -> int:
        return len(self.times_s)


def make_track(times_s: Sequence[float], positions: Sequence[LatLon]) -> FixTrack:
    """Sort fixes by time; of several with the same time the first is kept.

    Args:
        times_s: Seconds since 1970, UTC.
        positions: One for each time.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    latlon = np.asarray(positions, dtype=np.float64).reshape(-1, 2)
    unique, first = np.unique(times, return_index=True)
    return FixTrack(unique, latlon[first])


_NEAREST = 5
"""Number of nearest fixes to a photo's own position that propose the time when it was taken."""
_SAMPLE = 40
_NEAR_M = 30.0
_LEAST = 3


@dataclass(frozen=True, slots=True)
class Match:
    """A position on the track."""

    position: LatLon
    # Time between the two fixes around it; for the position of a single fix, the time to that fix.
    gap_s: float


@dataclass(frozen=True, slots=True)
class NoMatch:
    """No position, and the reason in a sentence. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True, slots=True)
class ClockOffset:
    offset_s: float  # To be added to the clock's time
    # Median distance between the photos' own positions and those on the track at the corrected times.
    median_m: float


def match(track: FixTrack, times_s: Sequence[float], *, max_gap_s: float) -> list[Match | NoMatch]:
    """Interpolate the positions at given times linearly between the fixes before and after.

    Across a gap longer than `max_gap_s`, before the first and after the last fix, the nearest fix is returned
    if it is at most `max_gap_s` / 2 away: no position is then a worse guess than inside an allowed gap.

    Args:
        track: Of at least one fix.
        times_s: Seconds since 1970, UTC.
        max_gap_s: Longest gap between two fixes over which positions are interpolated, seconds.

    Returns:
        One for each time.
    """
    return [_at(track, float(t), max_gap_s) for t in times_s]


def estimate_offset(track: FixTrack, times_s: ArrayLike, *, latlon: ArrayLike) -> ClockOffset | NoMatch:
    """Estimate the offset of a camera's clock from photos with known positions.

    For each photo, the times of the fixes closest to it each propose an offset; the one with the least median
    distance of the photos from the track is chosen.

    Args:
        track: Of at least one fix.
        times_s: (n,) float64. Of the camera's clock, seconds since 1970.
        latlon: (n, 2) float64. Where the photos were taken, degrees north and east.

    Returns:
        No match with fewer than three photos, or when they lie far from the track.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    positions = np.asarray(latlon, dtype=np.float64).reshape(-1, 2)
    if len(times) < _LEAST:
        return NoMatch(f"only {len(times)} photos have a time and a GPS position")
    chosen = np.unique(np.linspace(0, len(times) - 1, min(_SAMPLE, len(times))).astype(int))
    times, positions = times[chosen], positions[chosen]
    frame = LocalFrame(centre_of(positions))
    fixes, photos = frame.enu_from_latlon(track.latlon), frame.enu_from_latlon(positions)
    offsets = np.unique(
        np.concatenate([_moments(track, fixes, p) - t for t, p in zip(times, photos, strict=True)])
    )
    medians = np.array([_median_m(track, fixes, times + offset, photos=photos) for offset in offsets])
    best = int(np.argmin(medians))
    if not medians[best] <= _NEAR_M:
        return NoMatch("the photos with GPS positions are not near this track")
    return ClockOffset(float(offsets[best]), float(medians[best]))


def _at(track: FixTrack, t: float, max_gap_s: float) -> Match | NoMatch:
    times = track.times_s
    after = int(np.searchsorted(times, t))
    if 0 < after < len(times) and times[after] - times[after - 1] <= max_gap_s:
        gap = float(times[after] - times[after - 1])
        return Match(_between(track, after, (t - float(times[after - 1])) / gap), gap)
    around = [i for i in (after - 1, after) if 0 <= i < len(times)]
    nearest = min(around, key=lambda i: abs(float(times[i]) - t))
    away = abs(float(times[nearest]) - t)
    if away <= max_gap_s / 2.0:
        lat, lon = track.latlon[nearest].tolist()
        return Match(LatLon(lat, lon), away)
    if after == 0:
        return NoMatch(f"it was taken {_span(away)} before the track begins")
    if after == len(times):
        return NoMatch(f"it was taken {_span(away)} after the track ends")
    return NoMatch(f"the track has a gap of {_span(float(times[after] - times[after - 1]))} there")


def _between(track: FixTrack, after: int, share: float) -> LatLon:
    """Interpolate between a fix and the previous one, the short way around the Earth."""
    (lat, lon), (lat1, lon1) = track.latlon[after - 1].tolist(), track.latlon[after].tolist()
    east = (lon1 - lon + 180.0) % 360.0 - 180.0
    return LatLon(lat + share * (lat1 - lat), (lon + share * east + 180.0) % 360.0 - 180.0)


def _moments(track: FixTrack, fixes: NDArray[np.float64], photo: NDArray[np.float64]) -> NDArray[np.float64]:
    distances = np.hypot(*(fixes - photo).T)
    return track.times_s[np.argsort(distances, kind="stable")[:_NEAREST]]


def _median_m(
    track: FixTrack, fixes: NDArray[np.float64], times: NDArray[np.float64], *, photos: NDArray[np.float64]
) -> float:
    """Return the median distance of photos from the track at given times; infinite outside of the track."""
    east = np.interp(times, track.times_s, fixes[:, 0], left=np.inf, right=np.inf)
    north = np.interp(times, track.times_s, fixes[:, 1], left=np.inf, right=np.inf)
    return float(np.median(np.hypot(east - photos[:, 0], north - photos[:, 1])))


def _span(seconds: float) -> str:
    """Write a time span for people: seconds, minutes or hours."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
