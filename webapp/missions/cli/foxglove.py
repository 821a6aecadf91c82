"""`expmap foxglove mission`: a mission in Foxglove, live or as an MCAP file."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import click

from webapp.cli.foxglove import serve_until_interrupted, sink_options
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.core.geo.types import LatLon
from webapp.errors import Conflict, NotFound
from webapp.extras import require
from webapp.missions.core.trajectory.outgoing import ExportTrack
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.files.geojson_writer import format_mission_geojson
from webapp.missions.store import reading
from webapp.missions.store.schema import Mission
from webapp.render.colours import RGB
from webapp.render.foxglove import FoxglovePoint, FoxgloveSink
from webapp.store.database import Database

_LINE_POSES = 2000
"""Poses of each track in its line, which is redrawn after each change."""


@click.command(short_help="Show a mission.")
@click.argument("mission", metavar="MISSION", type=int)
@sink_options
@library_option
def mission(mission: int, out: Path | None, host: str, port: int, library: Path | None) -> None:
    """Show tracks and objects of MISSION, a number, live in Foxglove."""
    require("foxglove")
    with existing_library(library_settings(library)) as place:
        find_revision(place.database, mission)
        with FoxgloveSink(out=out, address=(host, port)) as sink:
            if out is None:
                follower = _Follower(place.database, mission)
                serve_until_interrupted(sink, host, poll=lambda: follower.send_changes(sink))
            else:
                send_mission(sink, place.database, number=mission)


def find_revision(database: Database, number: int) -> int:
    """Return the revision of a mission.

    Raises:
        NotFound: The mission does not exist.
    """
    with database.read() as session:
        found = session.get(Mission, number)
        if found is None:
            raise NotFound(f"there is no mission {number}", hint="expmap mission list")
        return found.revision


class _Follower:
    """Sends a mission again whenever it has changed."""

    def __init__(self, database: Database, number: int) -> None:
        self._database = database
        self._number = number
        self._revision: int | None = None

    def send_changes(self, sink: FoxgloveSink) -> None:
        revision = find_revision(self._database, self._number)
        if revision == self._revision:
            return
        try:
            found = reading.read(self._database, self._number, most=_LINE_POSES)
            lines = b"".join(format_mission_geojson(found)).decode("utf-8")
            ends = [(track, list(_poses(track))[-1]) for track in found.tracks]
        except Conflict:
            return  # a track was being rewritten: retry at the next poll
        newest_s = max((pose[0] for _, pose in ends), default=time.time())
        sink.shapes("/mission", lines, time_s=newest_s)
        for track, (time_s, point) in ends:
            sink.point(_topic(track), point, time_s=time_s)
        self._revision = revision


def send_mission(sink: FoxgloveSink, database: Database, *, number: int) -> None:
    """Send every pose of a mission with its time, then lines and objects."""
    last_s = 0.0
    for track in reading.read(database, number).tracks:
        for time_s, point in _poses(track):
            sink.point(_topic(track), point, time_s=time_s)
            last_s = max(last_s, time_s)
    lines = format_mission_geojson(reading.read(database, number, most=_LINE_POSES))
    sink.shapes("/mission", b"".join(lines).decode("utf-8"), time_s=last_s)


def _topic(track: ExportTrack) -> str:
    return f"/tracks/{track.source}" + (f"/{track.name}" if track.name else "")


def _poses(track: ExportTrack) -> Iterator[tuple[float, FoxglovePoint]]:
    red, green, blue = bytes.fromhex(track.colour.removeprefix("#"))
    for part in track.poses():
        for number in range(len(part)):
            yield float(part.times_s[number]), _point(part, number, colour=(red, green, blue))


def _point(poses: Poses, number: int, *, colour: RGB) -> FoxglovePoint:
    lat, lon = poses.latlon[number].tolist()
    heading, height = float(poses.heading_deg[number]), float(poses.height_m[number])
    east, north, both = poses.covariance_m2[number].tolist()
    return FoxglovePoint(
        LatLon(lat, lon),
        colour,
        covariance_m2=None if math.isnan(east) else (east, north, both),
        heading_deg=None if math.isnan(heading) else heading,
        height_m=None if math.isnan(height) else height,
    )
