"""Writes the poses and objects of a mission as tables: CSV with a header line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from webapp.files.exchange.times import utc, utc_or_none
from webapp.files.text_file import plain_cell
from webapp.missions.core.trajectory.outgoing import ExportTrack, MissionExport

POSE_COLUMNS = (
    "source", "track", "number", "time", "time_s", "lat", "lon", "height_m", "heading_deg",
    "var_e_m2", "var_n_m2", "cov_en_m2", "travelled_m", "thinned_m",
)  # fmt: skip
OBJECT_COLUMNS = (
    "id", "class", "lat", "lon", "height_m", "confidence", "sightings", "first_time", "last_time", "photo",
    "var_e_m2", "var_n_m2", "cov_en_m2", "size_x_m", "size_y_m", "size_z_m",
    "state", "state_time", "state_by",
)  # fmt: skip
_PART = 1000
_UNKNOWN = (None, None, None)


def format_poses_csv(mission: MissionExport) -> Iterator[bytes]:
    """Write all poses, track by track, a header line first.

    Yields:
        UTF-8. Times are written as ISO 8601 and in seconds since 1970, both UTC; tracks without times have
            empty cells. `thinned_m` is the largest error of thinning, `inf` if only both ends are left.
    """
    yield csv_lines([POSE_COLUMNS])
    for track in mission.tracks:
        first, thinned = 0, _thinned(track)
        for part in track.poses():
            table = np.column_stack(
                [part.latlon, part.height_m, part.heading_deg, part.covariance_m2, part.travelled_m]
            ).tolist()
            times = [("", "")] * len(part)
            if track.timed:
                seconds = (f"{time_s:.6f}" for time_s in part.times_s.tolist())
                times = list(zip(utc(part.times_s), seconds, strict=True))
            yield csv_lines(
                (track.source, track.name, number, *time, *map(_number, row), thinned)
                for number, (time, row) in enumerate(zip(times, table, strict=True), start=first)
            )
            first += len(part)


def format_objects_csv(mission: MissionExport) -> Iterator[bytes]:
    """Write all objects with their last positions, a header line first.

    Yields:
        UTF-8.
    """
    rows: list[Sequence[object]] = [OBJECT_COLUMNS]
    for found in mission.objects():
        numbers = map(_number, (*found.latlon, found.height_m, found.confidence))
        times = utc([found.first_time_s, found.last_time_s])
        measures = map(_number, (*(found.covariance_m2 or _UNKNOWN), *(found.size_m or _UNKNOWN)))
        state = (found.state, utc_or_none(found.state_time_s), found.state_by)
        rows.append((found.id, found.kind, *numbers, found.sightings, *times, found.photo, *measures, *state))
        if len(rows) == _PART:
            yield csv_lines(rows)
            rows = []
    yield csv_lines(rows)


def _thinned(track: ExportTrack) -> str:
    if not track.removed:
        return ""
    return "inf" if track.thinned_m is None else f"{track.thinned_m:g}"


def csv_lines(rows: Iterable[Sequence[object]]) -> bytes:
    """Format rows by RFC 4180 in UTF-8; None gives an empty cell, and formulas are neutralised."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerows([plain_cell(value) for value in row] for row in rows)
    return text.getvalue().encode("utf-8", "replace")


def _number(value: float | None) -> str:
    """Format a number with enough digits to round-trip."""
    return "" if value is None or value != value else repr(value)
