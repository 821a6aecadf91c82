"""Writes a mission as GPX 1.1, piece by piece: a track for each source, a waypoint for each object."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from webapp.core.trajectory.outgoing import MissionOut, ObjectOut
from webapp.core.trajectory.records import Poses
from webapp.files.exchange.times import utc
from webapp.files.exchange.xml import DECLARATION, element

NAMESPACE = "urn:experience-map:gpx"
"""Of `heading`, degrees clockwise from north, and `covariance`, square metres."""

_OPEN = (
    '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
    f'xmlns:e="{NAMESPACE}">\n'
)


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


def _waypoint(found: ObjectOut) -> str:
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
