"""The time of GPS, which has no leap seconds, and UTC."""

from __future__ import annotations

from bisect import bisect_right

_EPOCH_S = 315_964_800.0
"""1980-01-06, when weeks began to be counted."""

_WEEK_S = 604_800.0
_LEAPS = (
    (362_793_600.0, 1), (394_329_600.0, 2), (425_865_600.0, 3), (489_024_000.0, 4), (567_993_600.0, 5),
    (631_152_000.0, 6), (662_688_000.0, 7), (709_948_800.0, 8), (741_484_800.0, 9), (773_020_800.0, 10),
    (820_454_400.0, 11), (867_715_200.0, 12), (915_148_800.0, 13), (1_136_073_600.0, 14),
    (1_230_768_000.0, 15), (1_341_100_800.0, 16), (1_435_708_800.0, 17), (1_483_228_800.0, 18),
)  # fmt: skip
"""Beginnings in UTC of the times in which GPS is so many seconds ahead (IERS, Bulletin C)."""


def utc_from_gps(seconds: float) -> float:
    """Convert a reading of a GPS clock, as seconds since 1970, to UTC."""
    ahead = bisect_right([begin + leap - 1 for begin, leap in _LEAPS], seconds)
    return seconds - ahead


def utc_from_week(week: float, seconds: float) -> float:
    """Convert a week of GPS and the seconds in it to seconds since 1970, UTC."""
    return utc_from_gps(_EPOCH_S + week * _WEEK_S + seconds)
