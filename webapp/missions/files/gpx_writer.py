"""GPX of missions, writer: tracks, and objects as waypoints."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from webapp.files.exchange.gpx import NAMESPACE
from webapp.files.exchange.times import utc
from webapp.files.exchange.xml import DECLARATION, element
from webapp.missions.core.trajectory.outgoing import ExportObject, MissionExport
from webapp.missions.core.trajectory.records import Poses

_OPEN = (
    '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
    f'xmlns:e="{NAMESPACE}">\n'
)


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
