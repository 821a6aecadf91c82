"""Builds records in the format of the API from the arguments of the client."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat, TypedDict, Unpack

from .errors import InputError
from .fields import RECORDS, Covariance, FieldError, Number, Size, check_record


class PoseFields(TypedDict, total=False):
    """Optional fields of a pose.

    Attributes:
        heading_deg: Degrees clockwise from north.
        covariance: Square metres: variance east, variance north, covariance of the two.
        source: One of `fields.SOURCES`; defaults to `gps`.
        track: Name of the track, if there are several of one source.
        travelled_m: Metres since the first pose of the track; if missing, the server measures it.
        skipped: Poses left out since the last one that was sent.
    """

    height_m: SupportsFloat
    heading_deg: SupportsFloat
    covariance: Sequence[SupportsFloat]
    source: str
    track: str
    travelled_m: SupportsFloat
    skipped: int


class ObjectFields(TypedDict, total=False):
    """Optional fields of an object.

    Attributes:
        confidence: 0 to 1.
        covariance: Square metres: variance east, variance north, covariance of the two.
        size_m: Metres: length, width, height.
        photo: SHA-256 that `RobotClient.photo` returned.
    """

    height_m: SupportsFloat
    covariance: Sequence[SupportsFloat]
    confidence: SupportsFloat
    size_m: Sequence[SupportsFloat]
    photo: str


class StatusFields(TypedDict, total=False):
    """Optional fields of a status.

    Attributes:
        track: Name of the robot, as in its poses.
        battery_percent, link_percent: 0 to 100.
        mode: `auto`, `manual` ...
        text: A message to people, up to 200 characters.
    """

    track: str
    battery_percent: SupportsFloat
    link_percent: SupportsFloat
    mode: str
    text: str


def pose_record(
    lat: SupportsFloat, lon: SupportsFloat, *, time: SupportsFloat, **more: Unpack[PoseFields]
) -> dict[str, Any]:
    """Make the record of a pose.

    Args:
        lat, lon: Degrees north, degrees east, WGS 84.
        time: Seconds since 1970, UTC.

    Raises:
        InputError: A field has the wrong type, is out of range, or unknown.
    """
    given = {"time": time, "lat": lat, "lon": lon, **more}
    if given.get("track") == "":
        del given["track"]
    if given.get("skipped") == 0:
        del given["skipped"]
    record = _record("pose", given)
    if "heading_deg" in record:
        record["heading_deg"] = record["heading_deg"] % 360.0 % 360.0
    return record


def object_record(
    id: str | None,
    kind: str,
    *,
    lat: SupportsFloat,
    lon: SupportsFloat,
    time: SupportsFloat,
    **more: Unpack[ObjectFields],
) -> dict[str, Any]:
    """Make the record of an object that was seen.

    Args:
        id: Identifies the object across sightings; None: the server associates the sighting.
        kind: Its class: `car`, `victim` ...
        lat, lon: Degrees north, degrees east, WGS 84.
        time: Seconds since 1970, UTC.

    Raises:
        InputError: A field has the wrong type, is out of range, or unknown.
    """
    return _record("object", {"id": id, "class": kind, "time": time, "lat": lat, "lon": lon, **more})


def status_record(*, time: SupportsFloat, **more: Unpack[StatusFields]) -> dict[str, Any]:
    """Make the record of how a robot is.

    Args:
        time: Seconds since 1970, UTC.

    Raises:
        InputError: A field has the wrong type, is out of range, or unknown.
    """
    return _record("status", {"time": time, **more})


def end_record(left_out: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Make the record of the end of the mission.

    Args:
        left_out: For each track whose last poses were left out: `source`, `track`, `skipped`, and
            `travelled_m` including them.
    """
    return _record("end", {"left_out": list(left_out)} if left_out else {})


def parse_record(given: Mapping[str, Any], *, now_s: float) -> dict[str, Any]:
    """Check a record in the format of the API. Raises InputError.

    Args:
        now_s: Seconds since 1970, for a record without `time`.
    """
    fields = dict(given)
    match fields.pop("type", None):
        case "pose":
            return pose_record(**_with_place(fields, now_s=now_s))
        case "object":
            more = {"id": None, "kind": fields.pop("class", None)}
            return object_record(**more | _with_place(fields, now_s=now_s))
        case "status":
            return status_record(**{"time": now_s} | fields)
        case type_:
            return _record(type_, fields)


def to_json(record: Mapping[str, Any]) -> bytes:
    """Write a record as JSON.

    Raises:
        ValueError: The record holds a number that JSON cannot represent, such as NaN.
    """
    return json.dumps(record, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode("utf-8")


def _with_place(fields: dict[str, Any], *, now_s: float) -> dict[str, Any]:
    return {"time": now_s, "lat": None, "lon": None} | fields


def _record(type_: object, given: Mapping[str, Any]) -> dict[str, Any]:
    table = RECORDS.get(type_, {}) if isinstance(type_, str) else {}
    plain = {name: _plain(value, table.get(name)) for name, value in given.items() if value is not None}
    try:
        checked_type, checked = check_record({"type": type_, **plain})
    except FieldError as error:
        value = f"{plain[error.name]!r}: "[:60] if error.name in plain else ""
        raise InputError(
            value + error.message, where=error.name, hint="docs/robot-client.md lists the fields"
        ) from error
    return {"type": checked_type, **checked}


def _plain(value: Any, field: object) -> Any:
    """Convert number-like values, such as NumPy's; return others unchanged, for the check to reject."""
    try:
        if isinstance(field, Number) and not isinstance(value, (bool, int)):
            return int(value) if field.whole and float(value).is_integer() else float(value)
        if isinstance(field, (Covariance, Size)):
            return [float(part) for part in value]
    except (TypeError, ValueError, OverflowError):
        return value
    return value
