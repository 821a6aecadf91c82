"""TCX: training and courses of Garmin devices. Each activity and each course is a track."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import BinaryIO
from xml.etree.ElementTree import Element

from webapp.core.geo.types import LatLon
from webapp.files.exchange.times import unix_time
from webapp.files.exchange.xml import child_text, local_name, number, walk
from webapp.missions.core.trajectory.records import Sighting
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint, is_mostly_timed
from webapp.missions.files.track_chunks import UNTIMED_OBJECTS, Findings, Piece, WorldObjects
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_TRACKS = {"Activity": "activity", "Course": "course"}


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read the activities and courses.

    Args:
        file: Must be seekable.

    Raises:
        TrackError: The file is damaged, or declares a document type.
    """
    timed = _timed(file)
    file.seek(0)
    buffer: LineBuffer | None = None
    course_points = 0
    for line, element in _points(file):
        if local_name(element) == "CoursePoint":
            course_points += 1
            yield from _object(element, line, number=course_points, findings=findings)
            continue
        if buffer is None or buffer.name != line:
            if buffer is not None:
                yield from buffer.flush(findings)
            buffer = LineBuffer(line, timed=line in timed)
        point = _point(element)
        if point is None:
            findings.skip("points without a position", where=line)
        else:
            yield from buffer.add(point, findings=findings)
    if buffer is not None:
        yield from buffer.flush(findings)


def _timed(file: BinaryIO) -> set[str]:
    """Find the lines that count as timed."""
    counts: dict[str, tuple[int, int]] = {}
    for line, element in _points(file):
        if local_name(element) == "Trackpoint":
            timed, count = counts.get(line, (0, 0))
            known = not math.isnan(unix_time(child_text(element, "Time")))
            counts[line] = (timed + known, count + 1)
    return {line for line, (timed, count) in counts.items() if is_mostly_timed(timed, count)}


def _points(file: BinaryIO) -> Iterator[tuple[str, Element]]:
    """Yield the points of tracks and courses, each with the name of its line."""
    counts = dict.fromkeys(_TRACKS, 0)
    name = ""
    for event, element in walk(file, whole={"Trackpoint", "CoursePoint"}):
        kind = local_name(element)
        if event == "start" and kind in _TRACKS:
            counts[kind] += 1
            name = f"{_TRACKS[kind]} {counts[kind]}"
        elif event == "end" and kind in ("Trackpoint", "CoursePoint"):
            yield name or "track", element


def _position(element: Element) -> tuple[float, float] | None:
    place = next((child for child in element if local_name(child) == "Position"), None)
    if place is None:
        return None
    return number(child_text(place, "LatitudeDegrees")), number(child_text(place, "LongitudeDegrees"))


def _point(element: Element) -> LinePoint | None:
    place = _position(element)
    if place is None:
        return None
    return LinePoint(
        unix_time(child_text(element, "Time")), *place, number(child_text(element, "AltitudeMeters"))
    )


def _object(element: Element, line: str, *, number: int, findings: Findings) -> Iterator[Piece]:
    """Yield a course point; its id has its number in the file, since names such as `Left` repeat."""
    place, name = _position(element), " ".join(child_text(element, "Name").split())
    if place is None or any(map(math.isnan, place)):
        findings.skip("course points without a position", where=name or line)
        return
    time_s = unix_time(child_text(element, "Time"))
    if math.isnan(time_s):
        time_s = 0.0
        findings.note(UNTIMED_OBJECTS)
    kind = child_text(element, "PointType") or "waypoint"
    id_ = f"waypoint {number} {line} {name}".strip()
    yield WorldObjects((Sighting(id_, kind, time_s, LatLon(*place)),))


FORMAT = TrackFormat(
    "tcx",
    "TCX",
    "TCX",
    endings=(".tcx",),
    roots=frozenset({"TrainingCenterDatabase"}),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    numbered="waypoint",
    about=FormatAbout(
        tracks="activities and courses",
        objects="course points",
        left_out="heart rate, power, laps",
        written_by="Garmin Training Center, Garmin Connect",
    ),
)
