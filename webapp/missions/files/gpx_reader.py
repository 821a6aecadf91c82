"""GPX 1.0 and 1.1 as missions take it: tracks and routes are tracks, waypoints are objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO
from xml.etree.ElementTree import Element

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.records import Sighting, make_poses
from webapp.missions.files.track_chunks import CHUNK, UNTIMED, Findings, Piece, WorldObjects, WorldPiece
from webapp.missions.files.track_times import filled, unix_time
from webapp.missions.files.xml_stream import child_text, local_name, walk

_POINTS = {"trkpt", "rtept", "wpt"}
_LINES = {"trk": "track", "rte": "route"}


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a GPX file.

    Several segments of a track are joined. Points without a time get one between their neighbours; where
    none has a time they are counted as one second apart, from the file's own time on.

    Parameters
    ----------
    file : binary file
    findings : Findings

    Yields
    ------
    Piece

    Raises
    ------
    TrackError
        It is damaged, or declares a document type.
    """
    lines = {"trk": 0, "rte": 0}
    waypoints = 0
    file_time = 0.0
    line: _Line | None = None
    for event, element in walk(file, whole=_POINTS):
        name = local_name(element)
        if event == "start":
            if name in lines:
                lines[name] += 1
                line = _Line(f"{_LINES[name]} {lines[name]}", file_time)
            continue
        if name == "name" and line is not None:
            line.called = line.called or " ".join((element.text or "").split())
        elif name == "time" and line is None:
            file_time = _or(unix_time(element.text or ""), file_time)
        elif name == "wpt":
            waypoints += 1
            yield from _waypoint(element, waypoints, file_time, findings=findings)
        elif name in _POINTS and line is not None:
            line.points.append(_point(element))
            if line.full():
                yield line.piece()
        elif name in lines and line is not None:
            yield from line.rest(findings)
            line = None


@dataclass(slots=True)
class _Line:
    """The points of a track or route that are not given out yet."""

    place: str
    begin_s: float
    called: str = ""
    points: list[tuple[float, ...]] = field(default_factory=list)
    timed: bool = False
    given: int = 0

    @property
    def name(self) -> str:
        return f"{self.place} {self.called}".strip()

    def full(self) -> bool:
        """Tell whether a piece can be given: it has to end with a point whose time is known."""
        return len(self.points) >= CHUNK and (not math.isnan(self.points[-1][0]) or not self.timed)

    def piece(self) -> WorldPiece:
        times, lat, lon, height, course = np.array(self.points).T
        known = bool((~np.isnan(times)).any())
        times = filled(times.tolist(), begin_s=self.begin_s)
        self.timed = self.timed or known
        self.begin_s = float(times[-1]) + 1.0
        self.given += len(times)
        self.points = []
        latlon = np.column_stack([lat, lon])
        poses = make_poses(times, latlon, height_m=height, heading_deg=course)
        return WorldPiece(self.name, "gps", poses, self.timed)

    def rest(self, findings: Findings) -> Iterator[WorldPiece]:
        if self.points:
            yield self.piece()
        if not self.given:
            findings.skip("tracks and routes without a point", where=self.name)
        elif not self.timed:
            findings.note(UNTIMED)


def _point(element: Element) -> tuple[float, ...]:
    course = child_text(element, "course")
    return (
        unix_time(child_text(element, "time")),
        number(element.get("lat")),
        number(element.get("lon")),
        number(child_text(element, "ele")),
        number(course),
    )


def _waypoint(element: Element, count: int, file_time: float, *, findings: Findings) -> Iterator[Piece]:
    time_s, lat, lon, height, _ = _point(element)
    name = " ".join(child_text(element, "name").split())
    kind = child_text(element, "type") or child_text(element, "sym") or "waypoint"
    if math.isnan(time_s):
        findings.note("waypoints without a time have that of the file")
    yield WorldObjects(
        (
            Sighting(
                f"waypoint {count} {name}".strip(),
                kind,
                _or(time_s, file_time),
                LatLon(lat, lon),
                None if math.isnan(height) else height,
            ),
        )
    )


def number(text: str | None) -> float:
    """Read a finite number; NaN for what is none."""
    try:
        value = float(text) if text else math.nan
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _or(value: float, other: float) -> float:
    return other if math.isnan(value) else value
