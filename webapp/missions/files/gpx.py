"""GPX as missions take and give it: tracks and routes are tracks, waypoints are objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.outgoing import ExportObject, MissionOut
from webapp.core.trajectory.records import Poses, Sighting, make_poses
from webapp.files.exchange.gpx import GpxLine, GpxPoint, GpxWaypoint, read_gpx
from webapp.files.exchange.times import utc
from webapp.files.exchange.xml import DECLARATION, element
from webapp.missions.files.track_chunks import (
    CHUNK,
    UNTIMED,
    Findings,
    Piece,
    WorldObjects,
    WorldPiece,
    fill_times,
)

NAMESPACE = "urn:experience-map:gpx"
"""Of `heading`, degrees clockwise from north, and `covariance`, square metres."""

_OPEN = (
    '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
    f'xmlns:e="{NAMESPACE}">\n'
)


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a GPX file.

    Points without a time get one between their neighbours; where none has a time they are counted as one
    second apart, from the file's own time on.

    Raises
    ------
    TrackError
        It is damaged, or declares a document type.
    """
    buffer: _Buffer | None = None
    for item in read_gpx(file):
        if isinstance(item, GpxWaypoint):
            yield _object(item, findings=findings)
        elif isinstance(item, GpxLine):
            if buffer is not None:
                yield from buffer.flush(findings)
            buffer = _Buffer(item, _or_epoch(item.file_time_s))
        else:
            assert buffer is not None, "points follow their line"
            buffer.points.append(item)
            if buffer.full():
                yield buffer.piece()
    if buffer is not None:
        yield from buffer.flush(findings)


@dataclass(slots=True)
class _Buffer:
    """The points of a line that are in no piece yet."""

    line: GpxLine
    begin_s: float
    points: list[GpxPoint] = field(default_factory=list)
    timed: bool = False
    emitted: int = 0

    @property
    def name(self) -> str:
        return f"{self.line.kind} {self.line.number} {self.line.name}".strip()

    def full(self) -> bool:
        """Check whether a piece is complete: it has to end with a point whose time is known."""
        return len(self.points) >= CHUNK and (not math.isnan(self.points[-1].time_s) or not self.timed)

    def piece(self) -> WorldPiece:
        times, lat, lon, height, course = np.array(self.points).T
        known = bool((~np.isnan(times)).any())
        times = fill_times(times.tolist(), begin_s=self.begin_s)
        self.timed = self.timed or known
        self.begin_s = float(times[-1]) + 1.0
        self.emitted += len(times)
        self.points = []
        latlon = np.column_stack([lat, lon])
        poses = make_poses(times, latlon, height_m=height, heading_deg=course)
        return WorldPiece(self.name, "gps", poses, self.timed)

    def flush(self, findings: Findings) -> Iterator[WorldPiece]:
        if self.points:
            yield self.piece()
        if not self.emitted:
            findings.skip("tracks and routes without a point", where=self.name)
        elif not self.timed:
            findings.note(UNTIMED)


def _object(waypoint: GpxWaypoint, *, findings: Findings) -> WorldObjects:
    point = waypoint.point
    time_s = point.time_s
    if math.isnan(time_s):
        findings.note("waypoints without a time have that of the file")
        time_s = _or_epoch(waypoint.file_time_s)
    name = f"waypoint {waypoint.number} {waypoint.name}".strip()
    height = None if math.isnan(point.height_m) else point.height_m
    return WorldObjects((Sighting(name, waypoint.kind, time_s, LatLon(point.lat, point.lon), height),))


def _or_epoch(time_s: float) -> float:
    return 0.0 if math.isnan(time_s) else time_s


def format_mission_gpx(mission: MissionOut) -> Iterator[bytes]:
    """Write a mission.

    Yields
    ------
    bytes
        UTF-8. A track's source is its `src`, an object's class is its `type`.
    """
    for text in _pieces(mission):
        yield text.encode("utf-8", "replace")


def _pieces(mission: MissionOut) -> Iterator[str]:
    yield f"{DECLARATION}{_OPEN}<metadata>{element('name', mission.name)}</metadata>\n"
    for found in mission.objects():
        yield _waypoint(found)
    for track in mission.tracks:
        yield f"<trk>{element('name', track.title)}{element('src', track.source)}<trkseg>\n"
        for part in track.poses():
            yield _points(part, timed=track.timed)
        yield "</trkseg></trk>\n"
    yield "</gpx>\n"


def _waypoint(found: ExportObject) -> str:
    height = "" if found.height_m is None else f"<ele>{found.height_m:.3f}</ele>"
    return (
        f'<wpt lat="{found.latlon.lat:.9f}" lon="{found.latlon.lon:.9f}">{height}'
        f"<time>{utc([found.last_time_s])[0]}</time>"
        f"{element('name', found.id)}{element('type', found.kind)}</wpt>\n"
    )


def _points(poses: Poses, *, timed: bool) -> str:
    table = np.column_stack([poses.latlon, poses.height_m, poses.heading_deg, poses.covariance_m2]).tolist()
    times = [f"<time>{time}</time>" for time in utc(poses.times_s)] if timed else [""] * len(poses)
    return "".join(_point(time, row) for time, row in zip(times, table, strict=True))


def _point(time: str, row: list[float]) -> str:
    lat, lon, height, heading, *covariance = row
    ele = "" if math.isnan(height) else f"<ele>{height:.3f}</ele>"
    more = "" if math.isnan(heading) else f"<e:heading>{heading:.3f}</e:heading>"
    if not any(map(math.isnan, covariance)):
        more += f"<e:covariance>{' '.join(f'{value:.6g}' for value in covariance)}</e:covariance>"
    extensions = f"<extensions>{more}</extensions>" if more else ""
    return f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{ele}{time}{extensions}</trkpt>\n'
