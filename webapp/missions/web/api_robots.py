"""API of the robots of a mission: their status, when they were last heard, and the log of their silences."""

from __future__ import annotations

import time
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, List, Nested, String

from webapp.missions.store import robots
from webapp.missions.store.robots import Robot
from webapp.missions.store.schema import Mission
from webapp.missions.web.context import mission_role, open_mission
from webapp.web.context import library
from webapp.web.fields import Boolean

blueprint = APIBlueprint(
    "api_mission_robots", __name__, url_prefix="/api/v1/missions/<id:mission_id>", tag="Missions"
)


class RobotStatusOut(Schema):
    """What a robot said of itself last; null: not said."""

    time_s = Float(metadata={"description": "By the robot's clock."})
    battery_percent = Float(allow_none=True)
    link_percent = Float(allow_none=True)
    mode = String(allow_none=True)
    text = String(allow_none=True)


class RobotOut(Schema):
    """A robot or person that has sent batches."""

    name = String(metadata={"description": "That of its tracks; may be empty."})
    heard_time_s = Float(metadata={"description": "When the server last had a record of it."})
    silent = Boolean(metadata={"description": "For longer than the mission allows."})
    status = Nested(RobotStatusOut, allow_none=True)


class SilenceOut(Schema):
    """A time in which a robot was silent for longer than the mission allowed."""

    robot = String()
    since_s = Float()
    until_s = Float(allow_none=True, metadata={"description": "null: it is still silent."})


class RobotList(Schema):
    """The robots of a mission by name, and the log of their silences, the latest first."""

    clock_s = Float(metadata={"description": "Of the server, now."})
    silent_after_s = Float(allow_none=True, metadata={"description": "null: there is no alarm."})
    robots = List(Nested(RobotOut))
    silences = List(Nested(SilenceOut))


@blueprint.get("/robots")
@mission_role("viewer")
@blueprint.output(RobotList)
def list_robots(mission_id: int) -> dict[str, Any]:
    """List the robots of a mission with their last status, and when they were silent."""
    mission = open_mission(mission_id)
    with library().database.read() as session:
        row = session.get_one(Mission, mission.id)
        found, over = robots.list_robots(session, row.id), robots.list_silences(session, row.id)
    at_s = time.time()
    listed = [_robot(one, silent=_is_silent(row, one, at_s=at_s)) for one in found]
    still = [
        {"robot": one["name"], "since_s": one["heard_time_s"], "until_s": None}
        for one in listed
        if one["silent"]
    ]
    past = [{"robot": one.robot, "since_s": one.since_s, "until_s": one.until_s} for one in over]
    return {
        "clock_s": at_s,
        "silent_after_s": row.silent_after_s,
        "robots": listed,
        "silences": still + past,
    }


def _is_silent(mission: Mission, robot: Robot, *, at_s: float) -> bool:
    """Return whether a robot should have been heard; nobody waits for one after the end of the mission."""
    limit = mission.silent_after_s
    return limit is not None and mission.ended_at is None and at_s - robot.heard_time_s > limit


def _robot(robot: Robot, *, silent: bool) -> dict[str, Any]:
    said = robot.status
    status = None if said is None else {name: getattr(said, name) for name in RobotStatusOut().fields}
    return {"name": robot.name, "heard_time_s": robot.heard_time_s, "silent": silent, "status": status}
