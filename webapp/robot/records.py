"""The records that the server takes, made from what a robot's code says."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat, TypedDict, Unpack

from webapp.errors import InputError

SOURCES = ("gps", "odometry", "visual", "fused", "manual")
_MAX_TEXT = 200


class PoseFields(TypedDict, total=False):
    """What else may be known of a pose.

    Attributes
    ----------
    height_m : float
    heading_deg : float
        Degrees clockwise from north.
    covariance : sequence of 3 floats
        Square metres: variance east, variance north, covariance of the two.
    source : str
        One of `SOURCES`; `gps` where nothing is said.
    track : str
        Name of the track, where there are several of one source.
    travelled_m : float
        Metres since the first pose of the track; the server measures where nothing is said.
    skipped : int
        Poses left out since the last one that was sent.
    """

    height_m: SupportsFloat
    heading_deg: SupportsFloat
    covariance: Sequence[SupportsFloat]
    source: str
    track: str
    travelled_m: SupportsFloat
    skipped: int


class ObjectFields(TypedDict, total=False):
    """What else may be known of an object.

    Attributes
    ----------
    height_m : float
    confidence : float
        0 to 1.
    photo : str
        What `RobotClient.photo` returned.
    """

    height_m: SupportsFloat
    confidence: SupportsFloat
    photo: str


def pose_record(
    lat: SupportsFloat, lon: SupportsFloat, *, time: SupportsFloat, **more: Unpack[PoseFields]
) -> dict[str, Any]:
    """Make the record of a pose.

    Parameters
    ----------
    lat, lon : float
        Degrees north, degrees east, WGS 84.
    time : float
        Seconds since 1970, UTC.
    **more : PoseFields

    Raises
    ------
    InputError
        A field is no such thing, or unknown.
    """
    given: dict[str, Any] = dict(more)
    record: dict[str, Any] = {"type": "pose", **_where_and_when(lat, lon, time=time)}
    for name in ("height_m", "travelled_m"):
        if (value := given.pop(name, None)) is not None:
            record[name] = _number(name, value)
    if (heading := given.pop("heading_deg", None)) is not None:
        record["heading_deg"] = _number("heading_deg", heading) % 360.0 % 360.0
    if (covariance := given.pop("covariance", None)) is not None:
        record["covariance"] = _covariance(covariance)
    if (source := given.pop("source", None)) is not None:
        if source not in SOURCES:
            raise InputError(f"{source!r} is no source", where="source", hint=f"one of {', '.join(SOURCES)}")
        record["source"] = source
    if (track := given.pop("track", "")) != "":
        record["track"] = _text("track", track)
    if skipped := given.pop("skipped", 0):
        record["skipped"] = int(_number("skipped", skipped, least=0))
    return _nothing_left(record, given)


def object_record(
    id: str,
    kind: str,
    *,
    lat: SupportsFloat,
    lon: SupportsFloat,
    time: SupportsFloat,
    **more: Unpack[ObjectFields],
) -> dict[str, Any]:
    """Make the record of an object that was seen.

    Parameters
    ----------
    id : str
        The same for the same object at every sighting.
    kind : str
        Its class: `car`, `victim` ...
    lat, lon : float
        Degrees north, degrees east, WGS 84.
    time : float
        Seconds since 1970, UTC.
    **more : ObjectFields

    Raises
    ------
    InputError
        A field is no such thing, or unknown.
    """
    given: dict[str, Any] = dict(more)
    record: dict[str, Any] = {"type": "object", "id": _text("id", id), "class": _text("class", kind)}
    record |= _where_and_when(lat, lon, time=time)
    if (height := given.pop("height_m", None)) is not None:
        record["height_m"] = _number("height_m", height)
    if (confidence := given.pop("confidence", None)) is not None:
        record["confidence"] = _number("confidence", confidence, least=0.0, most=1.0)
    if (photo := given.pop("photo", None)) is not None:
        record["photo"] = _text("photo", photo)
    return _nothing_left(record, given)


def end_record(left_out: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Make the record that says that the mission is over.

    Parameters
    ----------
    left_out : sequence of mapping
        Of tracks whose last poses were left out: `source`, `track`, `skipped`, and `travelled_m` with them.
    """
    record: dict[str, Any] = {"type": "end"}
    return record | {"left_out": list(left_out)} if left_out else record


def parse_record(given: Mapping[str, Any], *, now_s: float) -> dict[str, Any]:
    """Check a record in the form in which it is sent.

    Parameters
    ----------
    given : mapping
    now_s : float
        Seconds since 1970, for a record without `time`.

    Raises
    ------
    InputError
        It is no record.
    """
    fields = dict(given)
    type_ = fields.pop("type", None)
    try:
        match type_:
            case "pose":
                return pose_record(**({"time": now_s} | fields))
            case "object":
                return object_record(**({"time": now_s, "kind": fields.pop("class", "")} | fields))
            case "end":
                return _nothing_left(end_record(), fields)
    except TypeError as error:
        raise InputError(f"a field of the {type_} is missing", hint=str(error).rpartition(") ")[2]) from error
    raise InputError(f"{type_!r} is no type of a record", where="type", hint="one of pose, object, end")


def to_json(record: Mapping[str, Any]) -> bytes:
    """Write a record as JSON.

    Raises
    ------
    ValueError
        It holds a number that JSON has not, such as NaN.
    """
    return json.dumps(record, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode("utf-8")


def _where_and_when(lat: SupportsFloat, lon: SupportsFloat, *, time: SupportsFloat) -> dict[str, Any]:
    return {
        "time": _number("time", time),
        "lat": _number("lat", lat, least=-90.0, most=90.0),
        "lon": _number("lon", lon, least=-180.0, most=180.0),
    }


def _number(name: str, value: SupportsFloat, *, least: float = -math.inf, most: float = math.inf) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{value!r} is no number", where=name) from error
    if not math.isfinite(number) or not least <= number <= most:
        between = f"{least:g} to {most:g}" if math.isfinite(most) else "a finite number"
        raise InputError(f"{number} is out of range", where=name, hint=f"give {between}, or leave it out")
    return number


def _covariance(values: Sequence[SupportsFloat]) -> list[float]:
    numbers = [_number("covariance", value) for value in values]
    if (
        len(numbers) != 3
        or min(numbers[:2]) < 0
        or numbers[2] ** 2 > numbers[0] * numbers[1] * (1 + 1e-6) + 1e-9
    ):
        raise InputError(
            "these are not the three numbers of a covariance",
            where="covariance",
            hint="give variance east, variance north, covariance of the two, in square metres",
        )
    return numbers


def _text(name: str, value: object) -> str:
    if not isinstance(value, str) or not 1 <= len(value) <= _MAX_TEXT or not value.isprintable():
        raise InputError(
            f"{str(value)[:40]!r} cannot be used",
            where=name,
            hint=f"give 1 to {_MAX_TEXT} printable characters",
        )
    return value


def _nothing_left(record: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    if given:
        raise InputError("there is no such field", where=next(iter(given)), hint="look at its spelling")
    return record
