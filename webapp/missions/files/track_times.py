"""Times as track files write them, and times for points that have none."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
from numpy.typing import NDArray

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ISO = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)(?:[T ](\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d+))?)?)?\s*(Z|[+-]\d\d(?::?\d\d)?)?",
    re.IGNORECASE,
)


def unix_time(text: str) -> float:
    """Read a date and time of ISO 8601, with or without separators; without a zone it is UTC.

    Returns
    -------
    float
        Seconds since 1970, UTC; NaN for what is none.
    """
    found = _ISO.fullmatch(text.strip())
    if found is None:
        return math.nan
    year, month, day, hour, minute, second = (int(part or 0) for part in found.groups()[:6])
    # a second of 60 is a leap second: it counts as the first of the next minute
    try:
        moment = datetime(year, month, day, hour, minute, tzinfo=_zone(found[8])) - _EPOCH
    except (ValueError, OverflowError):
        return math.nan
    if second > 60:
        return math.nan
    return moment / timedelta(seconds=1) + second + (float(f"0.{found[7]}") if found[7] else 0.0)


def filled(times_s: Sequence[float], *, begin_s: float) -> NDArray[np.float64]:
    """Give points without a time one, so that they stay in their order.

    Between two points with times they lie evenly; before the first and after the last they are one second
    apart; where no point has a time, the first is at `begin_s`.

    Parameters
    ----------
    times_s : sequence of float
        NaN where unknown.
    begin_s : float

    Returns
    -------
    (n,) float64
    """
    times = np.array(times_s, dtype=np.float64)
    known = np.flatnonzero(~np.isnan(times))
    places = np.arange(len(times), dtype=np.float64)
    if not len(known):
        return begin_s + places
    first, last = int(known[0]), int(known[-1])
    result = np.interp(places, known, times[known])
    result[:first] = times[first] + (places[:first] - first)
    result[last + 1 :] = times[last] + (places[last + 1 :] - last)
    return result


def _zone(text: str | None) -> timezone:
    if not text or text.upper() == "Z":
        return UTC
    digits = text[1:].replace(":", "").ljust(4, "0")
    offset = timedelta(hours=int(digits[:2]), minutes=int(digits[2:]))
    return timezone(-offset if text[0] == "-" else offset)
