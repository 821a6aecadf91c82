"""Reads and writes times of track files: ISO 8601."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
from numpy.typing import ArrayLike

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ISO = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)(?:[T ](\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d+))?)?)?\s*(Z|[+-]\d\d(?::?\d\d)?)?",
    re.IGNORECASE,
)


def unix_time(text: str) -> float:
    """Parse an ISO 8601 date and time, with or without separators; UTC if there is no time zone.

    Returns:
        Seconds since 1970, UTC; NaN for anything else.
    """
    found = _ISO.fullmatch(text.strip())
    if found is None:
        return math.nan
    year, month, day, hour, minute, second = (int(part or 0) for part in found.groups()[:6])
    # second 60 is a leap second: it is taken as second 0 of the next minute
    try:
        moment = datetime(year, month, day, hour, minute, tzinfo=_zone(found[8])) - _EPOCH
    except (ValueError, OverflowError):
        return math.nan
    if second > 60:
        return math.nan
    return moment / timedelta(seconds=1) + second + (float(f"0.{found[7]}") if found[7] else 0.0)


def utc(times_s: ArrayLike) -> list[str]:
    """Write times as ISO 8601, to the microsecond, in UTC: `2026-05-01T10:00:00.250000Z`.

    Args:
        times_s: (n,) array_like of float. Seconds since 1970.
    """
    microseconds = np.round(np.asarray(times_s, dtype=np.float64).reshape(-1) * 1e6).astype(np.int64)
    return [f"{time}Z" for time in np.datetime_as_string(microseconds.astype("datetime64[us]")).tolist()]


def utc_or_none(time_s: float | None) -> str | None:
    """Write one time like `utc`; None stays None."""
    return None if time_s is None else utc([time_s])[0]


def _zone(text: str | None) -> timezone:
    if not text or text.upper() == "Z":
        return UTC
    digits = text[1:].replace(":", "").ljust(4, "0")
    offset = timedelta(hours=int(digits[:2]), minutes=int(digits[2:]))
    return timezone(-offset if text[0] == "-" else offset)
