"""A batch of a robot's records, parsed from JSON: validated as a whole, then grouped by track."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.errors import InputError
from webapp.missions.core.trajectory.records import Poses, Sighting, make_poses
from webapp.robot.fields import FieldError, check_record

_WIDTH = 9
"""Number of columns of a pose."""
_NAN3 = (math.nan, math.nan, math.nan)

TrackKey = tuple[str, str]
"""Source and name of a track."""


@dataclass(frozen=True, slots=True)
class BatchTrack:
    """Poses of one track."""

    poses: Poses  # `travelled_m` is NaN where the robot did not send it
    # Number of poses that the robot left out between these, and after the last one if the track is over.
    skipped: int
    # Distance at the end of the track, poses left out after the last one included; NaN if not sent.
    travelled_m: float


@dataclass(frozen=True, slots=True)
class Status:
    """How a robot is, as it says; None for what it does not say."""

    robot: str  # Name of its tracks, perhaps empty
    time_s: float  # Seconds since 1970, UTC
    battery_percent: float | None
    link_percent: float | None
    mode: str | None
    text: str | None


@dataclass(frozen=True, slots=True)
class Batch:
    """The records of a batch, in their order."""

    tracks: dict[TrackKey, BatchTrack]  # By source and name
    sightings: list[Sighting]
    ends: bool  # Whether the mission is over
    statuses: list[Status] = field(default_factory=list)


@dataclass(slots=True)
class _Columns:
    rows: list[tuple[float, ...]] = field(default_factory=list)
    skipped: int = 0
    travelled_m: float = math.nan

    def part(self) -> BatchTrack:
        table = np.array(self.rows, dtype=np.float64).reshape(-1, _WIDTH)
        poses = make_poses(
            table[:, 0],
            table[:, 1:3],
            height_m=table[:, 3],
            heading_deg=table[:, 4],
            covariance_m2=table[:, 6:],
            travelled_m=table[:, 5],
        )
        return BatchTrack(poses, self.skipped, self.travelled_m)


def parse(records: Sequence[object]) -> Batch:
    """Read the records of a batch.

    Args:
        records: As `webapp.robot.fields` defines them: `{"type": "pose", "time", "lat", "lon", ...}`,
            `{"type": "object", "class", "time", "lat", "lon", ...}` `{"type": "status", "time", ...}`
            or `{"type": "end"}`.

    Raises:
        InputError: A record is invalid; `where` names it and its field: `records.17.lat`.
    """
    columns: dict[TrackKey, _Columns] = {}
    sightings: list[Sighting] = []
    statuses: list[Status] = []
    ends = False
    for place, record in enumerate(records):
        try:
            type_, given = check_record(record)
        except FieldError as error:
            where = ".".join(filter(None, ("records", str(place), error.name)))
            raise InputError(error.message, where=where, hint="nothing from the batch was stored") from error
        if type_ == "pose":
            track = columns.setdefault(_track(given), _Columns())
            track.rows.append(_pose(given))
            track.skipped += given.get("skipped", 0)
        elif type_ == "object":
            sightings.append(_sighting(given))
        elif type_ == "status":
            statuses.append(_status(given))
        else:
            ends = True
            for left_out in given.get("left_out", ()):
                track = columns.setdefault(_track(left_out), _Columns())
                track.skipped += left_out.get("skipped", 0)
                track.travelled_m = left_out.get("travelled_m", math.nan)
    return Batch({key: found.part() for key, found in columns.items()}, sightings, ends, statuses)


def _track(given: Mapping[str, Any]) -> TrackKey:
    return given.get("source", "gps"), given.get("track", "")


def _pose(given: Mapping[str, Any]) -> tuple[float, ...]:
    return (
        given["time"],
        given["lat"],
        given["lon"],
        given.get("height_m", math.nan),
        given.get("heading_deg", math.nan),
        given.get("travelled_m", math.nan),
        *given.get("covariance", _NAN3),
    )


def _status(given: Mapping[str, Any]) -> Status:
    said = (given.get(name) for name in ("battery_percent", "link_percent", "mode", "text"))
    return Status(given.get("track", ""), given["time"], *said)


def _sighting(given: Mapping[str, Any]) -> Sighting:
    return Sighting(
        given.get("id"),
        given["class"],
        given["time"],
        LatLon(given["lat"], given["lon"]),
        height_m=given.get("height_m"),
        confidence=given.get("confidence"),
        photo=given.get("photo"),
        covariance_m2=given.get("covariance"),
        size_m=given.get("size_m"),
    )
