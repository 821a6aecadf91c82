"""GPX of missions, reader and writer: tracks and routes are tracks, waypoints are objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.files.exchange.gpx import NAMESPACE, GpxLine, GpxPoint, GpxWaypoint, read_gpx
from webapp.files.exchange.times import utc
from webapp.files.exchange.xml import DECLARATION, element
from webapp.missions.core.trajectory.outgoing import ExportObject, MissionExport
from webapp.missions.core.trajectory.records import SOURCES, Poses, Sighting, Source
from webapp.missions.files.line_buffer import LineBuffer, LinePoint, is_mostly_timed
from webapp.missions.files.track_chunks import UNTIMED_OBJECTS, Findings, Piece, WorldObjects

_OPEN = (
    '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
    f'xmlns:e="{NAMESPACE}">\n'
)


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a GPX file.

    Headings are read from our own extension or `course`, covariances from our own extension.

    Args:
        file: Must be seekable.

    Raises:
        TrackError: The file is damaged, or declares a document type.
    """
    timed = _timed(file)
    file.seek(0)
    line: GpxLine | None = None
    buffer: LineBuffer | None = None
    for item in read_gpx(file):
        if isinstance(item, GpxWaypoint):
            yield _object(item, findings=findings)
        elif isinstance(item, GpxLine):
            if buffer is not None:
                yield from buffer.flush(findings)
            line, buffer = item, None
        else:
            assert line is not None, "points follow their line"
            if buffer is None:  # the name of a line comes before its points
                buffer = LineBuffer(
                    _name(line), timed=(line.kind, line.number) in timed, source=_source(line)
                )
            yield from buffer.add(LinePoint(*item), findings=findings)
    if buffer is not None:
        yield from buffer.flush(findings)


def _timed(file: BinaryIO) -> set[tuple[str, int]]:
    """Find the lines that count as timed."""
    counts: dict[tuple[str, int], tuple[int, int]] = {}
    line: GpxLine | None = None
    for item in read_gpx(file):
        if isinstance(item, GpxLine):
            line = item
        elif isinstance(item, GpxPoint) and line is not None:
            timed, count = counts.get((line.kind, line.number), (0, 0))
            counts[(line.kind, line.number)] = (timed + (not math.isnan(item.time_s)), count + 1)
    return {key for key, (timed, count) in counts.items() if is_mostly_timed(timed, count)}


def _name(line: GpxLine) -> str:
    return f"{line.kind} {line.number} {line.name}".strip()


def _source(line: GpxLine) -> Source:
    """Return the source of a track that this program wrote, or else `gps`."""
    return next((source for source in SOURCES if source == line.source), "gps")


def _object(waypoint: GpxWaypoint, *, findings: Findings) -> WorldObjects:
    point = waypoint.point
    time_s = point.time_s
    if math.isnan(time_s):
        findings.note(UNTIMED_OBJECTS)
        time_s = 0.0
    name = f"waypoint {waypoint.number} {waypoint.name}".strip()
    height = None if math.isnan(point.height_m) else point.height_m
    at = LatLon(point.lat, point.lon)
    return WorldObjects((Sighting(name, waypoint.kind, time_s, at, height, state=waypoint.state),))


def format_mission_gpx(mission: MissionExport) -> Iterator[bytes]:
    """Write a mission.

    Yields:
        UTF-8. `src` of a track is its source, `type` of a waypoint the object's class; the state is in an
            extension.
    """
    for text in _pieces(mission):
        yield text.encode("utf-8", "replace")


def _pieces(mission: MissionExport) -> Iterator[str]:
    yield f"{DECLARATION}{_OPEN}<metadata>{element('name', mission.name)}</metadata>\n"
    for found in mission.objects():
        yield _waypoint(found)
    for track in mission.tracks:
        source = f"<extensions>{element('e:source', track.source)}</extensions>"
        remark = element("cmt", track.remark) if track.remark else ""
        yield f"<trk>{element('name', track.title)}{remark}{element('src', track.source)}{source}<trkseg>\n"
        for part in track.poses():
            yield _points(part, timed=track.timed)
        yield "</trkseg></trk>\n"
    yield "</gpx>\n"


def _waypoint(found: ExportObject) -> str:
    height = "" if found.height_m is None else f"<ele>{found.height_m:.3f}</ele>"
    return (
        f'<wpt lat="{found.latlon.lat:.9f}" lon="{found.latlon.lon:.9f}">{height}'
        f"<time>{utc([found.last_time_s])[0]}</time>"
        f"{element('name', found.id)}{element('type', found.kind)}"
        f"<extensions>{element('e:state', found.state)}</extensions></wpt>\n"
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
