"""API of the tracks of a mission for display: how they look, as a line and as a profile."""

from __future__ import annotations

from typing import Any

import numpy as np
from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Float, Integer, List, Raw, String
from apiflask.validators import Length, Range, Regexp
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from webapp.errors import UsageError
from webapp.missions.core.looks import COLOUR, LEAST_WIDTH_PX, MAX_TITLE, MOST_WIDTH_PX
from webapp.missions.store import batches, tracks
from webapp.missions.store.schema import Track
from webapp.missions.tasks import track_display
from webapp.missions.tasks.track_display import LineView
from webapp.missions.web.api_missions import TrackOut
from webapp.missions.web.context import mission_role, open_mission
from webapp.missions.web.state import track_json
from webapp.web.context import library
from webapp.web.fields import RecordNumber

blueprint = APIBlueprint(
    "api_tracks",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>/tracks",
    tag="Missions",
)

_ID = "<id:track_id>"
_MOST_POINTS = 5000
_SIDES = ("south", "west", "north", "east")
_POINT = {
    "type": "array",
    "items": {"type": ["number", "null"]},
    "minItems": 5,
    "maxItems": 5,
    "description": "number, time_s, lat, lon, heading_deg or null",
}


class TrackLookChange(Schema):
    """Changes of how a track looks; fields that are not sent stay."""

    title = String(
        validate=Length(max=MAX_TITLE),
        metadata={"description": "Name to show; empty: by its source and name.", "example": "Team 2"},
    )
    colour = String(
        allow_none=True,
        validate=[Length(equal=7), Regexp(COLOUR)],
        metadata={"description": "`#rrggbb` in lower case; null: that of its source."},
    )
    width_px = Float(
        allow_none=True,
        allow_nan=False,
        validate=Range(LEAST_WIDTH_PX, MOST_WIDTH_PX),
        metadata={"description": "Of the line; null: the usual one."},
    )
    hidden = Boolean(metadata={"description": "true: pages show it only once it is ticked."})


class LineQuery(Schema):
    """The requested part of a track, and its resolution."""

    tolerance_m = Float(
        load_default=0.0,
        validate=Range(min=0),
        metadata={"description": "Maximum distance of a pose from the line."},
    )
    south = Float(validate=Range(-90, 90), metadata={"description": "Of a box, whose sides come together."})
    west = Float(validate=Range(-180, 180))
    north = Float(validate=Range(-90, 90))
    east = Float(validate=Range(-180, 180), metadata={"description": "Less than west: across 180 degrees."})
    since = RecordNumber(least=-1, load_default=-1, metadata={"description": "Only later numbers than it."})


class LineOut(Schema):
    """A track as a line of at most 5000 points."""

    level = Integer(
        metadata={"description": "-1: poses as they are; each further level is four times coarser."}
    )
    points = List(Raw(metadata=_POINT))
    gaps = List(Integer(), metadata={"description": "Places of points before which the line is broken."})
    complete = Boolean(metadata={"description": "Whether it is as fine as was asked for."})


class ProfileQuery(Schema):
    """Resolution of a profile."""

    points = Integer(load_default=1000, validate=Range(2, _MOST_POINTS))


class ProfileOut(Schema):
    """A track over time: the lowest and the highest pose of each part."""

    time_s = List(Float())
    travelled_m = List(Float())
    speed_mps = List(Float(allow_none=True))
    height_m = List(Float(allow_none=True))


def points_json(points: NDArray[np.float64]) -> list[list[float | None]]:
    """Return points (n, 5) as JSON: number, time_s, lat, lon, heading_deg; degrees to a millimetre."""
    rows = np.round(points, 8).tolist()
    return [
        [int(n), time, lat, lon, None if heading != heading else heading]
        for n, time, lat, lon, heading in rows
    ]


def line_json(session: Session, track: Track, query: dict[str, Any]) -> dict[str, Any]:
    """Return a track as a line for the fields of a `LineQuery`; the fields of `LineOut`.

    Raises:
        UsageError: The box lacks a side.
    """
    given = [query[side] for side in _SIDES if side in query]
    if len(given) not in (0, len(_SIDES)):
        raise UsageError("a box has four sides", where="south", hint="send south, west, north and east")
    box = (given[0], given[1], given[2], given[3]) if given else None
    found = track_display.track_line(session, track, LineView(query["tolerance_m"], box, query["since"]))
    return {
        "level": found.level,
        "points": points_json(found.points),
        "gaps": found.gaps.tolist(),
        "complete": found.complete,
    }


def profile_json(session: Session, track: Track, query: dict[str, Any]) -> dict[str, Any]:
    """Return the profile of a track for the fields of a `ProfileQuery`; the fields of `ProfileOut`."""
    samples = track_display.track_profile(session, track, points=query["points"])
    if not track.timed:
        samples[:, 2] = np.nan  # such times only give the order, not a speed
    columns = samples.T.tolist()
    time, travelled, speed, height = ([None if v != v else v for v in column] for column in columns)
    return {"time_s": time, "travelled_m": travelled, "speed_mps": speed, "height_m": height}


@blueprint.patch(f"/{_ID}")
@mission_role("editor")
@blueprint.input(TrackLookChange, arg_name="given")
@blueprint.output(TrackOut)
def change(mission_id: int, track_id: int, *, given: dict[str, Any]) -> dict[str, Any]:
    """Change the name, colour, width or visibility of a track, for all who look at it."""
    mission = open_mission(mission_id, "editor")
    with library().database.write(locks_rows=True) as session:
        row = batches.locked(session, mission.id)
        return track_json(session, tracks.change_look(session, row, id=track_id, fields=given))


@blueprint.get(f"/{_ID}/line")
@blueprint.input(LineQuery, location="query", arg_name="query")
@blueprint.output(LineOut)
def line(mission_id: int, track_id: int, query: dict[str, Any]) -> dict[str, Any]:
    """Get a track, or the part of it in a box, as a line."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        return line_json(session, tracks.find(session, mission.id, track_id), query)


@blueprint.get(f"/{_ID}/profile")
@blueprint.input(ProfileQuery, location="query", arg_name="query")
@blueprint.output(ProfileOut)
def profile(mission_id: int, track_id: int, query: dict[str, Any]) -> dict[str, Any]:
    """Get distance, speed and height of a track over time."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        return profile_json(session, tracks.find(session, mission.id, track_id), query)
