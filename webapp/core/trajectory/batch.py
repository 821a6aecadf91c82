"""A batch of records of a robot, as JSON holds them: checked as a whole, then sorted by their tracks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.records import SOURCES, Poses, Sighting, make_poses
from webapp.errors import InputError

_POSE = frozenset(
    {"type", "time", "lat", "lon", "height_m", "heading_deg", "covariance", "source", "track"}
    | {"travelled_m", "skipped"}
)
_OBJECT = frozenset({"type", "id", "class", "time", "lat", "lon", "height_m", "confidence", "photo"})
_END = frozenset({"type", "left_out"})
_LEFT_OUT = frozenset({"source", "track", "skipped", "travelled_m"})
_FIELDS = {"pose": _POSE, "object": _OBJECT, "end": _END}

_SHA256 = re.compile(r"[0-9a-f]{64}")
_FAR = 1e12
"""No time in seconds, way or height in metres is larger."""
_WIDTH = 9
"""Numbers of a pose."""
_NAN3 = (math.nan, math.nan, math.nan)

TrackKey = tuple[str, str]
"""Source and name of a track."""


@dataclass(frozen=True, slots=True)
class TrackPart:
    """Poses of one track.

    Attributes
    ----------
    poses : Poses
        `travelled_m` is NaN where the robot did not tell it.
    skipped : int
        Poses that the robot left out between these, and after the last one if it is over.
    travelled_m : float
        At the end, with those left out after the last one; NaN where the robot did not tell it.
    """

    poses: Poses
    skipped: int
    travelled_m: float


@dataclass(frozen=True, slots=True)
class Batch:
    """What a batch holds, in the order of the records.

    Attributes
    ----------
    tracks : dict of (str, str) to TrackPart
        By source and name.
    sightings : list of Sighting
    ends : bool
        Whether the mission is over.
    """

    tracks: dict[TrackKey, TrackPart]
    sightings: list[Sighting]
    ends: bool


@dataclass(slots=True)
class _Columns:
    rows: list[tuple[float, ...]] = field(default_factory=list)
    skipped: int = 0
    travelled_m: float = math.nan

    def part(self) -> TrackPart:
        table = np.array(self.rows, dtype=np.float64).reshape(-1, _WIDTH)
        poses = make_poses(
            table[:, 0],
            table[:, 1:3],
            height_m=table[:, 3],
            heading_deg=table[:, 4],
            covariance_m2=table[:, 6:],
            travelled_m=table[:, 5],
        )
        return TrackPart(poses, self.skipped, self.travelled_m)


def parse(records: Sequence[object]) -> Batch:
    """Read the records of a batch.

    Parameters
    ----------
    records : sequence
        A mapping each: `{"type": "pose", "time", "lat", "lon", ...}`, `{"type": "object", "id", "class",
        "time", "lat", "lon", ...}` or `{"type": "end"}`, which may tell with `left_out` of poses after
        the last ones: `{"source", "track", "skipped", "travelled_m"}` each.

    Returns
    -------
    Batch

    Raises
    ------
    InputError
        One of them cannot be used; `where` names it and its field: `records.17.lat`.
    """
    columns: dict[TrackKey, _Columns] = {}
    sightings: list[Sighting] = []
    ends = False
    for place, record in enumerate(records):
        try:
            kind, given = _told(record)
            if kind == "pose":
                track = columns.setdefault(_track(given), _Columns())
                track.rows.append(_pose(given))
                track.skipped += _skipped(given.get("skipped"))
            elif kind == "object":
                sightings.append(_sighting(given))
            else:
                ends = True
                _take_left_out(columns, given.get("left_out", []))
        except _Wrong as error:
            where = ".".join(("records", str(place), *error.args[1:]))
            raise InputError(error.args[0], where=where, hint="nothing of the batch was stored") from error
    return Batch({key: found.part() for key, found in columns.items()}, sightings, ends)


class _Wrong(Exception):
    """A record cannot be used: why, and its field where it is one."""


def _told(record: object) -> tuple[str, Mapping[str, Any]]:
    if not isinstance(record, Mapping):
        raise _Wrong("a record is an object with a type")
    kind = record.get("type")
    if not isinstance(kind, str) or kind not in _FIELDS:
        raise _Wrong("a record is of the type pose, object or end", "type")
    unknown = record.keys() - _FIELDS[kind]
    if unknown:
        raise _Wrong(f"a record of the type {kind} has no such field", str(min(unknown))[:40])
    return kind, record


def _pose(given: Mapping[str, Any]) -> tuple[float, ...]:
    return (
        _number(given, "time", _FAR),
        _number(given, "lat", 90.0),
        _number(given, "lon", 180.0),
        _maybe(given, "height_m", _FAR),
        _maybe(given, "heading_deg", _FAR),
        _travelled(given),
        *_covariance(given.get("covariance")),
    )


def _take_left_out(columns: dict[TrackKey, _Columns], told: object) -> None:
    for one in told if isinstance(told, list) else [told]:
        if not isinstance(one, Mapping) or not one.keys() <= _LEFT_OUT:
            raise _Wrong("it is a list of objects with source, track, skipped and travelled_m", "left_out")
        track = columns.setdefault(_track(one), _Columns())
        track.skipped += _skipped(one.get("skipped"))
        track.travelled_m = _travelled(one)


def _sighting(given: Mapping[str, Any]) -> Sighting:
    height, confidence = _maybe(given, "height_m", _FAR), _maybe(given, "confidence", 1.0)
    if confidence < 0:
        raise _Wrong("it is a number from 0 to 1", "confidence")
    photo = given.get("photo")
    if photo is not None and not (isinstance(photo, str) and _SHA256.fullmatch(photo)):
        raise _Wrong("it is the SHA-256 of a photo of the mission, 64 hexadecimal digits", "photo")
    return Sighting(
        _text(given.get("id"), "id"),
        _text(given.get("class"), "class"),
        _number(given, "time", _FAR),
        LatLon(_number(given, "lat", 90.0), _number(given, "lon", 180.0)),
        height_m=None if math.isnan(height) else height,
        confidence=None if math.isnan(confidence) else confidence,
        photo=photo,
    )


def _track(given: Mapping[str, Any]) -> TrackKey:
    source = given.get("source", "gps")
    if source not in SOURCES:
        raise _Wrong(f"it is one of {', '.join(SOURCES)}", "source")
    return source, _text(given.get("track", ""), "track", least=0)


def _number(given: Mapping[str, Any], name: str, most: float) -> float:
    """Read a number of a size up to `most`; true and false are none, and neither are NaN and infinity."""
    value = given.get(name)
    if type(value) is float or type(value) is int:
        if -most <= value <= most:
            return float(value)
        raise _Wrong(f"it is a number from {-most:g} to {most:g}", name)
    raise _Wrong("it is a number" if name in given else "it is missing", name)


def _maybe(given: Mapping[str, Any], name: str, most: float) -> float:
    return math.nan if given.get(name) is None else _number(given, name, most)


def _travelled(given: Mapping[str, Any]) -> float:
    metres = _maybe(given, "travelled_m", _FAR)
    if metres < 0:
        raise _Wrong("the way travelled is not negative", "travelled_m")
    return metres


def _covariance(value: object) -> tuple[float, float, float]:
    if value is None:
        return _NAN3
    if not isinstance(value, list) or len(value) != 3:
        raise _Wrong("it is [variance east, variance north, covariance], square metres", "covariance")
    named = dict(zip("012", value, strict=True))
    east, north, both = (_number(named, name, _FAR) for name in named)
    if east < 0 or north < 0 or both**2 > east * north * (1 + 1e-6) + 1e-9:
        raise _Wrong("no position has such a covariance", "covariance")
    return east, north, both


def _skipped(value: object) -> int:
    if value is None:
        return 0
    if type(value) is not int or not 0 <= value <= 10**9:
        raise _Wrong("it is a number of poses", "skipped")
    return value


def _text(value: object, name: str, *, least: int = 1, most: int = 200) -> str:
    if not isinstance(value, str) or not least <= len(value) <= most or not value.isprintable():
        raise _Wrong(f"it is a text of {least} to {most} printable characters", name)
    return value
