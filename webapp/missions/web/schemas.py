"""The shapes of what is told of missions, for the API's document and its answers."""

from __future__ import annotations

from apiflask import Schema
from apiflask.fields import Boolean, Dict, Float, Integer, List, Nested, String

from webapp.core.trajectory.records import SOURCES
from webapp.store.maps.maps import ROLES
from webapp.web.maps.schemas import SatelliteOut


class StartOut(Schema):
    """Where the robot's own frame has its origin, and its x axis."""

    lat = Float()
    lon = Float()
    heading_deg = Float(metadata={"description": "Clockwise from north."})


class LastOut(Schema):
    """The last pose of a track."""

    time_s = Float()
    lat = Float()
    lon = Float()
    heading_deg = Float(allow_none=True)


class ClosingOut(Schema):
    """By how much a track that comes back misses its start."""

    gap_m = Float()
    share = Float(metadata={"description": "Of the distance travelled."})


class TrackOut(Schema):
    """A track."""

    id = Integer()
    source = String(metadata={"enum": list(SOURCES)})
    name = String()
    poses = Integer()
    skipped = Integer(metadata={"description": "Poses that the sender left out."})
    distance_m = Float()
    duration_s = Float()
    timed = Boolean(
        metadata={
            "description": "false: its source tells no times. Those of its poses keep their order and "
            "mean nothing; duration and speeds are not known."
        }
    )
    first_time_s = Float(allow_none=True)
    last_time_s = Float(allow_none=True)
    bounds = List(Float(), allow_none=True, metadata={"description": "South, west, north, east."})
    last = Nested(LastOut, allow_none=True)
    closing = Nested(ClosingOut, allow_none=True, metadata={"description": "null: it does not come back."})


class MissionSummary(Schema):
    """A mission in a list."""

    id = Integer()
    name = String()
    url = String(metadata={"description": "Of its page."})
    map = String(allow_none=True, metadata={"description": "Slug of its map."})
    role = String(metadata={"enum": list(ROLES), "description": "Of who asks."})
    can_edit = Boolean()
    binned = Boolean()
    revision = Integer(metadata={"description": "Counts the changes."})
    created_at = String()
    changed_at = String()
    ended_at = String(allow_none=True)
    poses = Integer()
    distance_m = Float(metadata={"description": "Of the track that knows it best."})
    duration_s = Float()
    objects = Integer()
    photos = Integer()


class MissionList(Schema):
    """Missions, the last changed first."""

    missions = List(Nested(MissionSummary))
    next = String(allow_none=True, metadata={"description": "`after` for those that follow; null: none do."})


class MissionSatelliteOut(SatelliteOut):
    """The image of the mission's map."""

    georeference = Dict(allow_none=True, metadata={"description": "As in the state of the map."})


class MissionState(MissionSummary):
    """All of a mission but its poses, objects and photos themselves."""

    note = String()
    start = Nested(StartOut, allow_none=True)
    tracks = List(Nested(TrackOut))
    satellite = Nested(MissionSatelliteOut, allow_none=True)
    cursor = String(metadata={"description": "For the events: tells what of the mission is known."})
