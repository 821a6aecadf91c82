"""Positions as apps on phones send them, as the records of a robot.

Sources: the JSON of OwnTracks (https://owntracks.org/booklet/tech/json/), and the query parameters of
GPSLogger's custom URL, Traccar Client and OsmAnd, which differ in their names only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from webapp.core.hypotheses.priors import INSIDE_68
from webapp.errors import InputError

_NAMES = {
    "lat": ("lat", "latitude"),
    "lon": ("lon", "long", "lng", "longitude"),
    "time": ("timestamp", "time", "tst"),
    "height_m": ("altitude", "alt"),
    "accuracy_m": ("accuracy", "acc"),
    "battery_percent": ("batt", "battery"),
}
_LOCATION = {
    "lat": "lat",
    "lon": "lon",
    "time": "tst",
    "height_m": "alt",
    "accuracy_m": "acc",
    "battery_percent": "batt",
}
_MILLISECONDS_FROM = 1e11
"""Larger times are milliseconds, as OsmAnd sends them: seconds reach this number in the year 5138."""

_HINT = "see Phones in the guide to missions for what the app has to send"


def pose(values: Mapping[str, Any], *, track: str) -> dict[str, Any]:
    """Make the record of a pose.

    Args:
        values: `time`, `lat` and `lon`; `height_m` and `accuracy_m`, the radius that holds 68 %, may be None.

    Raises:
        InputError: A value is not a number, or the accuracy is negative.
    """
    record: dict[str, Any] = {"type": "pose", "source": "gps", "track": track}
    record |= {name: values[name] for name in ("time", "lat", "lon")}
    if values.get("height_m") is not None:
        record["height_m"] = values["height_m"]
    if values.get("accuracy_m"):
        variance = (values["accuracy_m"] / INSIDE_68) ** 2
        record["covariance"] = [variance, variance, 0.0]
    return record


def records(values: Mapping[str, Any], *, track: str) -> list[dict[str, Any]]:
    """Make the records of a position that `from_owntracks` or `from_parameters` read: with its battery."""
    found = [pose(values, track=track)]
    battery = values.get("battery_percent")
    if battery is not None and 0 <= battery <= 100:  # apps send -1 where they do not know
        found.append({"type": "status", "time": values["time"], "track": track, "battery_percent": battery})
    return found


def from_owntracks(message: Mapping[str, Any]) -> dict[str, Any] | None:
    """Read a message of OwnTracks; None for all but positions.

    Raises:
        InputError: It is a position that lacks something, or it is encrypted.
    """
    if message.get("_type") == "encrypted":
        raise InputError("the message is encrypted", hint="remove the encryption key in OwnTracks")
    if message.get("_type") != "location":
        return None
    return _read({name: message.get(given) for name, given in _LOCATION.items()})


def from_parameters(given: Mapping[str, str]) -> dict[str, Any]:
    """Read the parameters of an address.

    Raises:
        InputError: One is missing or not a number.
    """
    lower = {name.lower(): value for name, value in given.items()}
    found = {
        name: next((lower[one] for one in names if lower.get(one, "").strip()), None)
        for name, names in _NAMES.items()
    }
    return _read(found)


def _read(found: Mapping[str, Any]) -> dict[str, Any]:
    missing = [name for name in ("lat", "lon", "time") if found[name] is None]
    if missing:
        raise InputError(f"the position has no {missing[0]}", where=missing[0], hint=_HINT)
    values = {
        name: _number(name, found[name]) for name in found if name != "time" and found[name] is not None
    }
    values["time"] = _time(found["time"])
    if values.get("accuracy_m", 0.0) < 0:  # some receivers mark an unknown accuracy so
        del values["accuracy_m"]
    return values


def _number(name: str, value: object) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{value!r} is not a number"[:200], where=name, hint=_HINT)
    return number


def _time(value: object) -> float:
    """Read Unix seconds or milliseconds, or ISO 8601 with its offset from UTC."""
    if isinstance(value, str) and re.match(r"\d{4}-\d", value):
        try:
            at = datetime.fromisoformat(value.strip().replace(" ", "+"))  # a plus sign of an address
        except ValueError as error:
            raise InputError(f"{value!r} is not a time"[:200], where="time", hint=_HINT) from error
        if at.tzinfo is None:
            raise InputError(f"{value!r} does not say its offset from UTC"[:200], where="time", hint=_HINT)
        return at.timestamp()
    seconds = _number("time", value)
    return seconds / 1000 if seconds >= _MILLISECONDS_FROM else seconds
