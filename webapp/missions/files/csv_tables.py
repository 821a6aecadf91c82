"""Tables of poses and objects: CSV of any delimiter, with a header or not, is read; with one, written."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from webapp.core.columns import Column, Columns, guess_columns, parse_columns
from webapp.core.geo.types import LatLon
from webapp.core.trajectory.outgoing import MissionOut
from webapp.core.trajectory.records import SOURCES, Sighting, Source, make_poses
from webapp.core.trajectory.robotframe import LocalPoses
from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time, utc
from webapp.files.text_file import cell_text, delimiter_of, numbered_lines, plain_cell, split_row
from webapp.missions.files.track_chunks import (
    CHUNK,
    Findings,
    LocalSighting,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)

_NUMBERS = (
    "time",
    "lat",
    "lon",
    "x",
    "y",
    "z",
    "height",
    "heading",
    "yaw",
    "accuracy",
    "var_e",
    "var_n",
    "cov_en",
)

_UNKNOWN = dict.fromkeys(_NUMBERS, math.nan)

POSE_COLUMNS = (
    "source", "track", "number", "time", "time_s", "lat", "lon", "height_m", "heading_deg",
    "var_e_m2", "var_n_m2", "cov_en_m2", "travelled_m",
)  # fmt: skip
OBJECT_COLUMNS = (
    "id", "class", "lat", "lon", "height_m", "confidence", "sightings", "first_time", "last_time", "photo",
)  # fmt: skip
_PART = 1000


def read(file: BinaryIO, *, columns: str | None, findings: Findings) -> Iterator[Piece]:
    """Read a table.

    Rows with an id are objects, all others poses. Rows without a time count as one second after the last.
    With `lat` and `lon` rows are on the Earth, with `x` and `y` in the robot's frame.

    Parameters
    ----------
    columns : str or None
        Which column holds what (see `webapp.core.columns`); None to guess from the header.

    Raises
    ------
    TrackError
        The table is empty, or its columns are not recognized.
    UsageError
        `columns` does not fit the table.
    """
    lines = ((number, line) for number, line in numbered_lines(file) if line.strip() and line[0] != "#")
    first = next(lines, None)
    if first is None:
        raise TrackError("the table is empty")
    delimiter = delimiter_of(first[1]) or ","
    header = split_row(first[1], delimiter)
    known = parse_columns(columns, header) if columns else guess_columns(header)
    table = _Table(known, "," if delimiter != "," else ".")
    if columns and _is_data(header, table):
        yield from table.row(header, f"line {first[0]}", findings=findings)
    for number, line in lines:
        yield from table.row(split_row(line, delimiter), f"line {number}", findings=findings)
    yield from table.rest(findings)


@dataclass(slots=True)
class _Table:
    """Rows that are not given out yet, by track."""

    columns: Columns
    comma: str
    poses: dict[tuple[Source, str], list[list[float]]] = field(default_factory=dict)
    last_time_s: float = math.nan
    untimed: bool = False
    timed: set[tuple[Source, str]] = field(default_factory=set)
    """Tracks that have times."""

    def row(self, fields: Sequence[str], where: str, *, findings: Findings) -> Iterator[Piece]:
        given = {name: self.number(fields, name) for name in self.columns if name in _UNKNOWN}
        values = _UNKNOWN | given
        place = ("lat", "lon") if "lat" in self.columns else ("x", "y")
        if any(math.isnan(values[name]) for name in place):
            findings.skip("rows without a position", where=where)
            return
        track = (self.source(fields), self.text(fields, "track"))
        if not math.isnan(values["time"]):
            self.timed.add(track)
        else:
            self.untimed = True
            values["time"] = 0.0 if math.isnan(self.last_time_s) else self.last_time_s + 1.0
        self.last_time_s = values["time"]
        if "id" in self.columns and (name := self.text(fields, "id")):
            if "lat" not in self.columns:  # the first pose, where the frame begins, has to come before
                yield from self.rest(findings)
            yield self.sighting(fields, name, values)
            return
        rows = self.poses.setdefault(track, [])
        rows.append([values[name] for name in _NUMBERS])
        if len(rows) == CHUNK:
            yield self.piece(track)

    def rest(self, findings: Findings) -> Iterator[Piece]:
        """Return the remaining rows."""
        if self.untimed:
            findings.note("rows without a time count as one second after the row before")
        for track in list(self.poses):
            yield self.piece(track)

    def piece(self, key: tuple[Source, str]) -> Piece:
        source, track = key
        columns = dict(zip(_NUMBERS, np.array(self.poses.pop(key)).T, strict=True))
        variance = columns["accuracy"] ** 2
        no_covariance = np.where(np.isnan(variance), math.nan, 0.0)
        covariance = np.column_stack(
            [
                np.where(np.isnan(columns["var_e"]), variance, columns["var_e"]),
                np.where(np.isnan(columns["var_n"]), variance, columns["var_n"]),
                np.where(np.isnan(columns["cov_en"]), no_covariance, columns["cov_en"]),
            ]
        )
        if "lat" in self.columns:
            latlon = np.column_stack([columns["lat"], columns["lon"]])
            poses = make_poses(
                columns["time"],
                latlon,
                height_m=columns["height"],
                heading_deg=columns["heading"],
                covariance_m2=covariance,
            )
            return WorldPiece(track, source, poses, key in self.timed)
        up = np.where(np.isnan(columns["z"]), 0.0, columns["z"])
        xyz = np.column_stack([columns["x"], columns["y"], up])
        local = LocalPoses(columns["time"], xyz, columns["yaw"], covariance)
        return RobotPiece(track, source, "", "", local, key in self.timed)

    def sighting(self, fields: Sequence[str], name: str, values: dict[str, float]) -> Piece:
        kind = self.text(fields, "class") or "object"
        sure = self.number(fields, "confidence")
        confidence = None if math.isnan(sure) else sure
        if "lat" in self.columns:
            height = None if math.isnan(values["height"]) else values["height"]
            at = LatLon(values["lat"], values["lon"])
            return WorldObjects((Sighting(name, kind, values["time"], at, height, confidence),))
        up = 0.0 if math.isnan(values["z"]) else values["z"]
        xyz = (values["x"], values["y"], up)
        return RobotObjects("", (LocalSighting(name, kind, values["time"], xyz, confidence),))

    def source(self, fields: Sequence[str]) -> Source:
        given = self.text(fields, "source").lower()
        usual: Source = "gps" if "lat" in self.columns else "odometry"
        return next((source for source in SOURCES if source == given), usual)

    def text(self, fields: Sequence[str], name: str) -> str:
        column = self.columns.get(name)
        return cell_text(fields[column.index].strip()) if column and column.index < len(fields) else ""

    def number(self, fields: Sequence[str], name: str) -> float:
        """Return a field as a number in its usual unit; NaN for what is not one."""
        text = self.text(fields, name)
        if not text:
            return math.nan
        column: Column = self.columns[name]
        try:
            value = float(text.replace(",", ".") if self.comma == "," else text) * column.scale
            if name == "time" and column.scale == 1.0:
                value = _seconds(value)
        except ValueError:
            value = unix_time(text) if name == "time" else math.nan
        return value if math.isfinite(value) else math.nan


def _seconds(value: float) -> float:
    """Take numbers that no time in seconds has for milli-, micro- or nanoseconds."""
    for unit, most in ((1e9, 1e17), (1e6, 1e14), (1e3, 1e11)):
        if abs(value) >= most:
            return value / unit
    return value


def _is_data(header: Sequence[str], table: _Table) -> bool:
    """Return whether the first line is a row already: the columns of positions hold numbers."""
    place = ("lat", "lon") if "lat" in table.columns else ("x", "y")
    return all(not math.isnan(table.number(header, name)) for name in place)


def format_poses_csv(mission: MissionOut) -> Iterator[bytes]:
    """Write all poses, track by track, a header line first.

    Yields
    ------
    bytes
        UTF-8. Times are written as ISO 8601 and in seconds since 1970, both UTC; those that no source has
        are left out.
    """
    yield csv_lines([POSE_COLUMNS])
    for track in mission.tracks:
        first = 0
        for part in track.poses():
            table = np.column_stack(
                [part.latlon, part.height_m, part.heading_deg, part.covariance_m2, part.travelled_m]
            ).tolist()
            times = [("", "")] * len(part)
            if track.timed:
                seconds = (f"{time_s:.6f}" for time_s in part.times_s.tolist())
                times = list(zip(utc(part.times_s), seconds, strict=True))
            yield csv_lines(
                (track.source, track.name, number, *time, *map(_number, row))
                for number, (time, row) in enumerate(zip(times, table, strict=True), start=first)
            )
            first += len(part)


def format_objects_csv(mission: MissionOut) -> Iterator[bytes]:
    """Write all objects, where they were seen last, a header line first.

    Yields
    ------
    bytes
        UTF-8.
    """
    rows: list[Sequence[object]] = [OBJECT_COLUMNS]
    for found in mission.objects():
        numbers = map(_number, (*found.latlon, found.height_m, found.confidence))
        times = utc([found.first_time_s, found.last_time_s])
        rows.append((found.id, found.kind, *numbers, found.sightings, *times, found.photo))
        if len(rows) == _PART:
            yield csv_lines(rows)
            rows = []
    yield csv_lines(rows)


def csv_lines(rows: Iterable[Sequence[object]]) -> bytes:
    """Write lines as RFC 4180 has them, in UTF-8; None is empty, and no text is a formula."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerows([plain_cell(value) for value in row] for row in rows)
    return text.getvalue().encode("utf-8", "replace")


def _number(value: float | None) -> str:
    """Write a number with as many digits as it takes to read the same one back."""
    return "" if value is None or value != value else repr(value)
