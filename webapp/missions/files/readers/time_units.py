"""Times in files: the unit of plain numbers, by one rule for all formats, and the time of GPS in UTC."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import ArrayLike

_PER_SECOND = (("nanoseconds", 1e9, 1e17), ("microseconds", 1e6, 1e14), ("milliseconds", 1e3, 1e11))
"""Units by name, how many are a second, and the least times in them: those of 1973."""

_LEAST = _PER_SECOND[-1][2]

LAST_S = 253_402_300_800.0
"""The year 10000: later numbers are no times."""

_EPOCH_S = 315_964_800.0
"""1980-01-06, when weeks began to be counted."""

WEEK_S = 604_800.0
_LEAPS = (
    (362_793_600.0, 1), (394_329_600.0, 2), (425_865_600.0, 3), (489_024_000.0, 4), (567_993_600.0, 5),
    (631_152_000.0, 6), (662_688_000.0, 7), (709_948_800.0, 8), (741_484_800.0, 9), (773_020_800.0, 10),
    (820_454_400.0, 11), (867_715_200.0, 12), (915_148_800.0, 13), (1_136_073_600.0, 14),
    (1_230_768_000.0, 15), (1_341_100_800.0, 16), (1_435_708_800.0, 17), (1_483_228_800.0, 18),
)  # fmt: skip
"""Beginnings in UTC of the times in which GPS is so many seconds ahead (IERS, Bulletin C)."""


def per_second(times: ArrayLike) -> float:
    """Infer how many units of times since 1970 are a second, from their median; 1 for seconds."""
    values = np.abs(np.asarray(times, dtype=np.float64))
    values = values[np.isfinite(values)]
    return ticks(float(np.median(values))) if len(values) else 1.0


def ticks(time: float) -> float:
    """Infer how many units of one time are a second."""
    if not abs(time) >= _LEAST:  # also NaN
        return 1.0
    return next(count for _, count, least in _PER_SECOND if abs(time) >= least)


def unit_remark(count: float, example: float) -> str:
    """Return the note on an inferred unit, as returned by `per_second`; empty for seconds."""
    unit = next((name for name, known, _ in _PER_SECOND if known == count), "")
    return f"times such as {example:.0f} were read as {unit} since 1970" if unit else ""


def utc_from_gps(seconds: float) -> float:
    """Convert a reading of a GPS clock, as seconds since 1970, to UTC."""
    ahead = bisect_right([begin + leap - 1 for begin, leap in _LEAPS], seconds)
    return seconds - ahead


def utc_from_week(week: float, seconds: float) -> float:
    """Convert a week of GPS and the seconds in it to seconds since 1970, UTC."""
    return utc_from_gps(_EPOCH_S + week * WEEK_S + seconds)
