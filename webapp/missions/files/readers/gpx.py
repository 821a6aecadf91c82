"""GPX of missions, reader: tracks and routes are tracks, waypoints are objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import BinaryIO

from webapp.core.geo.types import LatLon
from webapp.files.exchange.gpx import GpxLine, GpxPoint, GpxWaypoint, read_gpx
from webapp.missions.core.trajectory.records import SOURCES, Sighting, Source
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint, is_mostly_timed
from webapp.missions.files.track_chunks import UNTIMED_OBJECTS, Findings, Piece, WorldObjects
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened


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


FORMAT = TrackFormat(
    "gpx",
    "GPX",
    "GPX",
    endings=(".gpx",),
    roots=frozenset({"gpx"}),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    numbered="waypoint",
    about=FormatAbout(
        tracks="tracks and routes; headings and covariances as in `export.gpx`",
        objects="waypoints",
        left_out="pictures, links, extensions of other programs",
        written_by="GPS receivers, watches, phones, OsmAnd, Strava",
    ),
)
