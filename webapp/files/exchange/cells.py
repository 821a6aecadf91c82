"""Parses cells of loggers' tables: numbers with units, angles with hemispheres, dates in many orders."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import date

from webapp.files.exchange.times import unix_time

_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(\S.*)?", re.IGNORECASE)
_WORDS = {"metres": "m", "meters": "m", "meter": "m", "metre": "m", "feet": "ft", "°": "deg", "sec": "s"}
_HEMISPHERE = re.compile(r"[NSEW]")
_NUMBERS = re.compile(r"\d+(?:\.\d+)?")
_ANGLE_MARKS = re.compile(r"[-+NSEW\d.,\s°ºd'’′\"”″:]*", re.IGNORECASE)

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_YEAR_FIRST = re.compile(r"(\d{4})([-/.])(\d{1,2})\2(\d{1,2})|(\d{4})(\d\d)(\d\d)")
_YEAR_LAST = re.compile(r"(\d{1,2})([-/. ])(\d{1,2})\2(\d{4}|\d\d)")
_SIX = re.compile(r"(\d\d)(\d\d)(\d\d)")
_NAMED = re.compile(
    r"(\d{1,2})[-/. ]+([a-z]{3})[a-z]*[-/., ]+(\d{4})|([a-z]{3})[a-z]*[. ]+(\d{1,2}),? +(\d{4})"
)
_CLOCK = re.compile(
    r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,:](\d+))?)?\s*([ap]\.?m\.?)?\s*(?:Z|UTC|GMT)?", re.IGNORECASE
)
_PACKED_CLOCK = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d+))?")


def quantity(text: str, *, scale: float, units: Mapping[str, float]) -> float:
    """Parse a number that may be followed by its unit: `98.470 m`.

    Args:
        scale: Factor for numbers without a unit.
        units: Factors of the accepted units.

    Returns:
        The number times its factor; NaN for anything else, including other units.
    """
    found = _QUANTITY.fullmatch(text)
    if found is None:
        return math.nan
    if found[2]:
        word = found[2].strip().lower()
        scale = units.get(_WORDS.get(word, word), math.nan)
    return float(found[1]) * scale


def angle(text: str, *, scale: float, hemispheres: str) -> float:
    """Parse a latitude or longitude to degrees: `50.1`, `0.134°S`, `N50 05.040`, `50° 5' 2.4" N`.

    Args:
        scale: Factor for a plain number.
        hemispheres: `NS` or `EW`: the accepted letters, that of negative angles last.

    Returns:
        Degrees; NaN for anything else.
    """
    try:
        return float(text) * scale
    except ValueError:
        pass
    letters = _HEMISPHERE.findall(text.upper())
    parts = [float(part) for part in _NUMBERS.findall(text)]
    bad = len(letters) > 1 or not 1 <= len(parts) <= 3 or not _ANGLE_MARKS.fullmatch(text)
    if bad or any(letter not in hemispheres for letter in letters) or any(part >= 60 for part in parts[1:]):
        return math.nan
    size = sum(part / 60.0**place for place, part in enumerate(parts))
    negative = text.lstrip().startswith("-") or letters == [hemispheres[1]]
    return -size if negative else size


def day_order(text: str) -> str | None:
    """Infer from a date whether the day or the month comes first: `dmy` or `mdy`.

    Returns:
        `?` where both are possible; None for dates in another order or with dots, and for other text.
    """
    found = _YEAR_LAST.fullmatch(text)
    if found is None or found[2] == ".":
        return None
    first, second = int(found[1]), int(found[3])
    if first > 12 or second > 12:
        return "dmy" if second <= 12 else "mdy"
    return "?"


def day_of(text: str, *, order: str) -> date | None:
    """Parse a date; None if it is not one, or its order is unknown.

    Args:
        order: "ymd", "dmy", "mdy" or "". Of dates that end with the year or have six digits. If empty, six
            digits are `ymd`.
    """
    try:
        return _day_of(text.strip(), order)
    except ValueError:
        return None


def seconds_of_day(text: str, *, packed: bool = False) -> float:
    """Parse a time of day: `13:03:22.836`, `1:03 PM`; NaN for anything else.

    Args:
        packed: Whether to accept six digits, `130322.8`, too.
    """
    text = text.strip()
    found = _CLOCK.fullmatch(text)
    half = (found[5] or "")[:1].lower() if found else ""
    if found is None and packed:
        found = _PACKED_CLOCK.fullmatch(text)
    if found is None:
        return math.nan
    hour, minute, second = int(found[1]), int(found[2]), int(found[3] or 0)
    if hour > (12 if half else 23) or minute > 59 or second > 60:
        return math.nan
    if half:
        hour = hour % 12 + (12 if half == "p" else 0)
    fraction = float(f"0.{found[4]}") if found[4] else 0.0
    return hour * 3600.0 + minute * 60.0 + second + fraction


def split_datetime(text: str) -> tuple[str, str]:
    """Split a cell with a date and a time of day; the time is empty if there is no colon."""
    head, colon, _ = text.partition(":")
    day = head.rstrip("0123456789") if colon else text
    return day.strip(" \tT,"), text[len(day) :].strip() if colon else ""


def moment(day_text: str, clock_text: str, *, order: str) -> float:
    """Combine a date and a time of day (UTC) to seconds since 1970; NaN where either is invalid."""
    day = day_of(day_text, order=order)
    if day is None:
        return math.nan
    return unix_time(day.isoformat()) + seconds_of_day(clock_text, packed=True)


def _day_of(text: str, order: str) -> date | None:
    found = _YEAR_FIRST.fullmatch(text)
    if found is not None:
        year, month, day = (found[1], found[3], found[4]) if found[1] else (found[5], found[6], found[7])
        return date(int(year), int(month), int(day))
    found = _NAMED.fullmatch(text.lower())
    if found is not None:
        day, name, year = (found[1], found[2], found[3]) if found[1] else (found[5], found[4], found[6])
        return date(int(year), _MONTHS.index(name) + 1, int(day))
    found = _YEAR_LAST.fullmatch(text)
    if found is not None:
        order = "dmy" if found[2] == "." else order
        return _ordered((found[1], found[3], found[4]), order) if order else None
    found = _SIX.fullmatch(text)
    return _ordered((found[1], found[2], found[3]), order or "ymd") if found else None


def _ordered(parts: tuple[str, str, str], order: str) -> date:
    values = {letter: int(part) for letter, part in zip(order, parts, strict=True)}
    year = values["y"]
    if year < 100:
        year += 2000 if year < 80 else 1900
    return date(year, values["m"], values["d"])
