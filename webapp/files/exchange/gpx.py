"""GPX 1.0 and 1.1: a streaming reader of tracks, routes and waypoints, and a walk as GPX."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, Literal, NamedTuple
from xml.etree.ElementTree import Element

from webapp.core.geo.types import LatLon
from webapp.core.trajectory import FixTrack, make_track
from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.files.exchange.xml import DECLARATION, child_text, local_name, number, walk
from webapp.files.exchange.xml import element as xml_element

SUFFIX = ".gpx"

MAX_BYTES = 30_000_000
"""Limit of `parse_gpx`, which reads from memory."""

MAX_FIXES = 200_000

NAMESPACE = "urn:experience-map:gpx"
"""Of our extensions: `heading` (degrees clockwise from north) and `covariance` (square metres) of points,
`source` of tracks, and `state` of waypoints."""

_COVARIANCE = 3
_POINTS = {"trkpt", "rtept", "wpt"}
_LINES: dict[str, Literal["track", "route"]] = {"trk": "track", "rte": "route"}


@dataclass(slots=True, eq=False)
class GpxLine:
    """Header of a track or route, followed by its points; the segments of a track are joined."""

    kind: Literal["track", "route"]  #
    number: int  # Counted from 1 within its kind
    # `name`, `source`: Set when the reader finds them: before the points, in a valid file. The source is our
    # extension.
    name: str = ""
    source: str = ""


class GpxPoint(NamedTuple):
    """A point of the preceding line; NaN for missing or invalid values."""

    time_s: float  # Seconds since 1970, UTC
    # `lat`, `lon`: Degrees.
    lat: float
    lon: float
    height_m: float
    course_deg: float  # Degrees clockwise from north: our extension `heading`, or else `course` of GPX 1.0
    # `var_e`, `var_n`, `cov_en`: Our extension `covariance`, square metres.
    var_e: float = math.nan
    var_n: float = math.nan
    cov_en: float = math.nan


@dataclass(frozen=True, slots=True)
class GpxWaypoint:
    """A waypoint; its kind is its `type` or else `sym`, its state our extension or else empty."""

    number: int
    name: str
    kind: str
    point: GpxPoint
    state: str = ""
    links: tuple[str, ...] = ()  # Addresses: `link` of GPX 1.1, `url` of 1.0


def read_gpx(file: BinaryIO) -> Iterator[GpxLine | GpxPoint | GpxWaypoint]:
    """Read a GPX file of any size.

    Yields:
        Each line before its points. Positions are not checked.

    Raises:
        TrackError: The XML is malformed, or declares a document type.
    """
    counts = dict.fromkeys((*_LINES, "wpt"), 0)
    line: GpxLine | None = None
    for event, element in walk(file, whole=_POINTS):
        name = local_name(element)
        if event == "start":
            if name in _LINES:
                counts[name] += 1
                line = GpxLine(_LINES[name], counts[name])
                yield line
        elif name == "wpt":
            counts[name] += 1
            yield _waypoint(element, counts[name])
        elif name in _LINES:
            line = None
        elif line is None:
            continue
        elif name in _POINTS:
            yield _point(element)
        elif name == "name":
            line.name = line.name or _one_line(element.text or "")
        elif element.tag == f"{{{NAMESPACE}}}source":
            line.source = (element.text or "").strip()


def parse_gpx(data: bytes) -> FixTrack:
    """Read the tracks of a small GPX file as a single one.

    Fixes without a time or a valid latitude and longitude are left out; so are routes and waypoints.

    Raises:
        TrackError: The file is too large or malformed, declares a document type (which can exhaust a reader's
            memory), or has fewer than two fixes with times.
    """
    if len(data) > MAX_BYTES:
        raise TrackError(
            f"the file is larger than {MAX_BYTES // 10**6} MB", hint="export a part of the track"
        )
    points: list[GpxPoint] = []
    of_track = False
    for item in read_gpx(io.BytesIO(data)):
        if isinstance(item, GpxLine):
            of_track = item.kind == "track"
        elif isinstance(item, GpxPoint) and of_track:
            points.append(item)
            if len(points) > MAX_FIXES:
                raise TrackError(f"the track has more than {MAX_FIXES} points", hint="export a part of it")
    return _track(points)


def _track(points: list[GpxPoint]) -> FixTrack:
    timed = [point for point in points if not math.isnan(point.time_s)]
    fixes = [point for point in timed if abs(point.lat) <= 90.0 and abs(point.lon) <= 180.0]
    track = make_track([fix.time_s for fix in fixes], [LatLon(fix.lat, fix.lon) for fix in fixes])
    if len(track) >= 2:
        return track
    if not points:
        raise TrackError("the file has no track", hint="routes and waypoints have no times: export the track")
    hint = "export the track with times" if not timed else None
    raise TrackError(
        f"of {len(points)} points of the track, {len(track)} have distinct times",
        hint=hint,
    )


def _point(element: Element) -> GpxPoint:
    course, covariance = _extensions(element)
    return GpxPoint(
        unix_time(child_text(element, "time")),
        number(element.get("lat")),
        number(element.get("lon")),
        number(child_text(element, "ele")),
        number(child_text(element, "course")) if math.isnan(course) else course,
        *covariance,
    )


def _extensions(element: Element) -> tuple[float, tuple[float, ...]]:
    """Read our extensions `heading`, and `covariance` if it is complete."""
    heading: float = math.nan
    covariance: tuple[float, ...] = ()
    for name, text in _own_extensions(element):
        if name == "heading":
            heading = number(text)
        elif name == "covariance":
            covariance = tuple(map(number, text.split()))
    return heading, covariance if len(covariance) == _COVARIANCE else ()


def _own_extensions(element: Element) -> Iterator[tuple[str, str]]:
    """Yield names and texts of our extensions."""
    ours = f"{{{NAMESPACE}}}"
    for outer in element:
        for inner in outer if local_name(outer) == "extensions" else ():
            if inner.tag.startswith(ours):
                yield inner.tag.removeprefix(ours), inner.text or ""


def _waypoint(element: Element, count: int) -> GpxWaypoint:
    kind = child_text(element, "type") or child_text(element, "sym") or "waypoint"
    state = next((text.strip() for name, text in _own_extensions(element) if name == "state"), "")
    links = tuple(
        found
        for part in element
        if local_name(part) in ("link", "url") and (found := (part.get("href") or part.text or "").strip())
    )
    return GpxWaypoint(count, _one_line(child_text(element, "name")), kind, _point(element), state, links)


def _one_line(text: str) -> str:
    return " ".join(text.split())


@dataclass(frozen=True, slots=True)
class WalkPoint:
    name: str
    description: str  # What to do there
    latlon: LatLon
    heading_deg: float | None = None  # Where to look first, degrees clockwise from north


def format_walk_gpx(points: Sequence[WalkPoint], *, title: str) -> Iterator[bytes]:
    """Write a walk.

    Yields:
        UTF-8, GPX 1.1: each point as a waypoint and as a point of the only route.
    """
    for text in _pieces(points, title):
        yield text.encode("utf-8", "replace")


def _pieces(points: Sequence[WalkPoint], title: str) -> Iterator[str]:
    yield DECLARATION
    yield (
        '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
        f'xmlns:e="{NAMESPACE}">\n<metadata>{xml_element("name", title)}</metadata>\n'
    )
    yield from (_walk_point("wpt", point) for point in points)
    yield f"<rte>{xml_element('name', title)}\n"
    yield from (_walk_point("rtept", point) for point in points)
    yield "</rte>\n</gpx>\n"


def _walk_point(tag: str, point: WalkPoint) -> str:
    inner = xml_element("name", point.name) + xml_element("desc", point.description)
    if point.heading_deg is not None:
        inner += f"<extensions><e:heading>{point.heading_deg:.0f}</e:heading></extensions>"
    return f'<{tag} lat="{point.latlon.lat:.7f}" lon="{point.latlon.lon:.7f}">{inner}</{tag}>\n'
