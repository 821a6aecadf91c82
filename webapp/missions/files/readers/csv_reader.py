"""Tables of poses and objects: CSV with any delimiter, with or without a header.

A table is read twice: first for its global properties (which tracks have times, whether the day or the month
comes first in its dates, which axes its frame has), then for its rows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import BinaryIO

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.missions.core.trajectory.axes import Axes, Frames, detect_frames, rotations_of, to_robot
from webapp.missions.core.trajectory.records import Sighting, make_poses
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files.readers.csv_table import (
    Key,
    Table,
    date_order,
    open_table,
    table_rows,
    time_name,
    with_marks,
)
from webapp.missions.files.readers.line_buffer import is_mostly_timed
from webapp.missions.files.track_chunks import (
    BAD_COVARIANCE,
    CHUNK,
    FEW_TIMES,
    NO_TIME,
    UNTIMED,
    UNTIMED_OBJECTS,
    Findings,
    LocalSighting,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
    object_field,
)
from webapp.missions.files.track_format import Beginning, FormatAbout, Selection, TrackFormat, opened

_QUATERNION = ("qx", "qy", "qz", "qw")
_NUMBERS = (
    "time", "lat", "lon", "x", "y", "z", *_QUATERNION, "height", "heading", "yaw", "accuracy",
    "var_e", "var_n", "cov_en",
)  # fmt: skip
_UNKNOWN = dict.fromkeys(_NUMBERS, math.nan)
_NO_FIX = {"no fix", "nofix", "none", "invalid", "v", "void", "no", "false"}
_SAMPLED = 20_000
"""Number of rows used to detect the axes of a frame, and whether there are times."""


def read(
    file: BinaryIO, *, columns: str | None, findings: Findings, axes: Axes | None = None
) -> Iterator[Piece]:
    """Read a table.

    Rows with an id are objects, all others poses. With `lat` and `lon` rows are on the Earth, with `x` and
    `y` in the robot's frame.

    Args:
        file: Must be seekable.
        columns: Meaning of the columns (see `webapp.core.columns`); None to infer it from the header.
        axes: Axes of the frame; None to detect them.

    Raises:
        TrackError: The table is empty, or its columns are not recognized.
        UsageError: `columns` does not fit the table, or its time column holds no times.
    """
    table = with_marks(file, open_table(file, columns))
    for remark in table.remarks:
        findings.note(remark)
    rows = _Rows(table, _survey(file, table, columns, axes=axes, findings=findings))
    for where, fields in table_rows(file, table):
        yield from rows.row(fields, where, findings=findings)
    yield from rows.rest()


@dataclass(frozen=True, slots=True)
class _Survey:
    """Properties that are detected in a first pass over the rows."""

    timed: frozenset[Key]  # Tracks that have times
    order: str  # Order of day, month and year in dates: see `Table`
    frames: Frames


def _survey(
    file: BinaryIO, table: Table, columns: str | None, *, axes: Axes | None, findings: Findings
) -> _Survey:
    order = date_order(file, table, findings=findings)
    known = replace(table, order=order)
    timed: Counter[Key] = Counter()
    counts: Counter[Key] = Counter()
    places: list[list[float]] = []
    has_time = table.has_times
    whole = "track" in table.columns or "source" in table.columns
    wants_axes = axes is None and "lat" not in table.columns and "qx" in table.columns
    for number, (_, fields) in enumerate(table_rows(file, table)):
        counts[known.key(fields)] += 1
        if has_time and not math.isnan(known.time(fields)):
            timed[known.key(fields)] += 1
        if wants_axes and number < _SAMPLED:
            places.append([known.number(fields, name) for name in ("x", "y", "z", *_QUATERNION)])
        if number < _SAMPLED or whole:
            continue
        if not has_time or is_mostly_timed(timed.total(), counts.total()):
            break
    if has_time and not timed:
        name = time_name(table)
        if columns and "time" in table.columns:
            hint = "name the column that has the times, or none"
            raise UsageError(f"nothing in the column {name!r} is a time", where="columns", hint=hint)
        findings.note(f"nothing in the column {name!r} is a time")
    frames = Frames(axes or "robot", axes or "robot")
    if wants_axes and places:
        numbers = np.array(places)
        frames, remark = detect_frames(numbers[:, :3], rotations_of(numbers[:, 3:]), usual=frames)
        findings.note(remark)
    mostly = frozenset(key for key, count in counts.items() if is_mostly_timed(timed[key], count))
    return _Survey(mostly, order, frames)


@dataclass(slots=True)
class _Rows:
    """Converts rows to pieces; buffers poses by track."""

    table: Table
    survey: _Survey
    poses: dict[Key, list[list[float]]] = field(default_factory=dict)
    counted: dict[Key, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.table = replace(self.table, order=self.survey.order)

    def row(self, fields: Sequence[str], where: str, *, findings: Findings) -> Iterator[Piece]:
        table = self.table
        if table.text(fields, "valid").lower() in _NO_FIX:
            findings.skip("fixes marked invalid by the receiver", where=where)
            return
        values = _UNKNOWN | {name: table.number(fields, name) for name in table.columns if name in _UNKNOWN}
        values["time"] = table.time(fields)
        place = ("lat", "lon") if "lat" in table.columns else ("x", "y")
        if any(math.isnan(values[name]) for name in place):
            findings.skip("rows without a position", where=where)
            return
        if "id" in table.columns and (name := table.text(fields, "id")):
            if "lat" not in table.columns:  # poses first: the first one is the origin of the frame
                yield from self.rest()
            yield self.sighting(fields, name, values, findings=findings)
            return
        key = table.key(fields)
        if key not in self.survey.timed:
            findings.skip(FEW_TIMES, where=where, count=int(not math.isnan(values["time"])))
            values["time"] = float(self.counted.get(key, 0))
            self.counted[key] = self.counted.get(key, 0) + 1
            findings.note(UNTIMED)
        elif math.isnan(values["time"]):
            findings.skip(NO_TIME, where=where)
            return
        rows = self.poses.setdefault(key, [])
        rows.append([values[name] for name in _NUMBERS])
        if len(rows) == CHUNK:
            yield self.piece(key)

    def rest(self) -> Iterator[Piece]:
        for track in list(self.poses):
            yield self.piece(track)

    def piece(self, key: Key) -> Piece:
        source, track = key
        columns = dict(zip(_NUMBERS, np.array(self.poses.pop(key)).T, strict=True))
        timed = key in self.survey.timed
        covariance = _covariance(columns)
        if "lat" in self.table.columns:
            poses = make_poses(
                columns["time"],
                np.column_stack([columns["lat"], columns["lon"]]),
                height_m=columns["height"],
                heading_deg=np.where(np.isnan(columns["heading"]), _heading_of(columns), columns["heading"]),
                covariance_m2=covariance,
            )
            return WorldPiece(track, source, poses, timed)
        xyz = np.column_stack([columns["x"], columns["y"], np.nan_to_num(columns["z"])])
        rotation = rotations_of(np.column_stack([columns[name] for name in _QUATERNION]))
        local = to_robot(columns["time"], xyz, rotation=rotation, frames=self.survey.frames)
        yaw = np.where(np.isnan(columns["yaw"]), local.yaw_rad, columns["yaw"])
        local = LocalPoses(local.times_s, local.xyz_m, yaw, covariance)
        return RobotPiece(track, source, "", "", local, timed)

    def sighting(
        self, fields: Sequence[str], name: str, values: Mapping[str, float], *, findings: Findings
    ) -> Piece:
        kind = self.table.text(fields, "class") or "object"
        sure = self.table.number(fields, "confidence")
        confidence = None if math.isnan(sure) else sure
        time_s = values["time"]
        if math.isnan(time_s):
            time_s = 0.0
            findings.note(UNTIMED_OBJECTS)
        if "lat" in self.table.columns:
            height = None if math.isnan(values["height"]) else values["height"]
            at = LatLon(values["lat"], values["lon"])
            spread = _covariance({key: np.array([value]) for key, value in values.items()})[0].tolist()
            covariance = object_field("covariance", spread)
            if covariance is None and not any(map(math.isnan, spread)):
                findings.note(BAD_COVARIANCE)
            seen = Sighting(name, kind, time_s, at, height, confidence, covariance_m2=covariance)
            return WorldObjects((seen,))
        up = 0.0 if math.isnan(values["z"]) else values["z"]
        xyz = (values["x"], values["y"], up)
        return RobotObjects("", (LocalSighting(name, kind, time_s, xyz, confidence),))


def _covariance(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the covariance (n, 3) of rows; where it is missing, compute it from the accuracy."""
    variance = columns["accuracy"] ** 2
    usual = (variance, variance, np.where(np.isnan(variance), math.nan, 0.0))
    given = (columns[name] for name in ("var_e", "var_n", "cov_en"))
    return np.column_stack([np.where(np.isnan(g), u, g) for g, u in zip(given, usual, strict=True)])


def _heading_of(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return headings from orientations relative to east, north, up; x of the body is forward (REP 103)."""
    rotation = rotations_of(np.column_stack([columns[name] for name in _QUATERNION]))
    none = np.zeros((len(rotation), 3))
    yaw = to_robot(columns["time"], none, rotation=rotation, frames=Frames("robot", "robot")).yaw_rad
    heading: np.ndarray = 90.0 - np.degrees(yaw)
    return heading


def _is_table(beginning: Beginning) -> bool:
    return any(mark in beginning.content for mark in ",;\t|")


def _read(file: BinaryIO, selection: Selection, findings: Findings) -> Iterator[Piece]:
    yield from read(file, columns=selection.columns, findings=findings, axes=selection.axes)


FORMAT = TrackFormat(
    "csv",
    "table",
    "CSV",
    endings=(".csv", ".txt"),
    is_one=_is_table,
    read=opened(_read),
    has_axes=True,
    about=FormatAbout(
        tracks="rows of a table with `,` `;` `|`, tabs or blanks; split by a column `track` if there is one; "
        "a header may be a comment (`#timestamp [ns], p_RS_R_x [m] ...` of EuRoC)",
        objects="rows with an `id`",
        left_out="columns that are [not named](#columns-of-a-table)",
        written_by="loggers, drones, spreadsheets",
    ),
)
