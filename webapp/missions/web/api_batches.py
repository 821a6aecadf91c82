"""API for robots: batches, each record of which is stored exactly once, and their status."""

from __future__ import annotations

import time
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import Length, Predicate, Regexp
from flask import Response, jsonify, request

from webapp.errors import UsageError
from webapp.missions.store import robots
from webapp.missions.store.batches import FILE, OutOfOrder
from webapp.missions.store.robots import Robot
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import store_batch
from webapp.missions.tasks.store_batch import Numbered
from webapp.missions.web.context import mission_role, open_mission
from webapp.robot.fields import record_schema
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import library, settings
from webapp.web.errors import as_json
from webapp.web.fields import Boolean, BoundedList, JsonValue, RecordNumber

blueprint = APIBlueprint("api_batches", __name__, url_prefix="/api/v1/missions", tag="Missions")

_HEADER = "Idempotency-Key"
_MAX_NAME = 200
_NAME = [
    Length(1, _MAX_NAME),
    Predicate("isprintable"),
    Regexp(f"(?!{FILE})", error=f"Names that begin with {FILE} are those of imported files."),
]
_SHARE = 0.75

_MOST_RECORDS = 100_000
_RECORD_BYTES, _RECORD_VALUES = 10_000, 40
"""Of one record."""
_AVERAGE_BYTES = 400
"""Of all records of a batch."""

_limit = ConcurrencyLimit("batches", share=_SHARE)
blueprint.record(_limit.set_up)


class BatchIn(Schema):
    """Records; with `sender` and `first`, or else with the header `Idempotency-Key`."""

    sender = String(
        validate=_NAME,
        metadata={"description": "Whose numbers these are; no other program may use the name."},
    )
    first = RecordNumber(
        strict=True,
        metadata={"description": "Number of the first record, counted from 0 by the sender."},
    )
    records = BoundedList(
        JsonValue(bytes=_RECORD_BYTES, values=_RECORD_VALUES, metadata=record_schema()),
        required=True,
        most=_MOST_RECORDS,
    )


class BatchKeyIn(Schema):
    """The key by which a batch is recognised when it is sent again."""

    key = String(
        load_default=None,
        data_key=_HEADER,
        validate=_NAME,
        metadata={"description": "Another one for each batch; instead of `sender` and `first`."},
    )


class BatchOut(Schema):
    """The acknowledgement of a batch that is on the disk."""

    next = Integer(allow_none=True, metadata={"description": "Number of the record that comes next."})
    stored = Integer(metadata={"description": "Records that are new."})
    already = Integer(metadata={"description": "Records that were stored before."})
    revision = Integer(metadata={"description": "Of the mission."})


@blueprint.before_request
def limit_bytes() -> None:
    """Limit the size of batches; larger ones are refused while they are read."""
    request.max_content_length = settings().missions.batch_records * _AVERAGE_BYTES


@blueprint.errorhandler(OutOfOrder)
def answer_out_of_order(error: OutOfOrder) -> Response:
    """Answer with the number to continue from."""
    response = jsonify(error=as_json(error) | {"code": "conflict", "next": error.next_seq})
    response.status_code = 409
    return response


@blueprint.post("/<id:mission_id>/batches")
@mission_role("editor")
@blueprint.input(BatchIn, arg_name="given")
@blueprint.input(BatchKeyIn, location="headers", arg_name="sent")
@blueprint.output(BatchOut)
@blueprint.doc(
    description="All records of a batch are stored, or none. The answer comes when they are on the disk; a "
    "client that lost it sends the batch again, and no record is stored twice. A batch without records "
    "asks for the next number. A batch after a gap is answered by 409 with `error.next`. When the server is "
    "busy it answers 503: wait for as long as `Retry-After` says."
)
def send(mission_id: int, *, given: dict[str, Any], sent: dict[str, str | None]) -> dict[str, Any]:
    """Send poses and objects of a mission."""
    mission, records = open_mission(mission_id, "editor"), given["records"]
    most = settings().missions.batch_records
    if len(records) > most:
        raise UsageError(
            f"{len(records)} records in one batch", where="records", hint=f"send at most {most} at once"
        )
    numbered, key = _numbered(given), sent["key"]
    if (numbered is None) == (key is None):
        raise UsageError(
            "the batch has no number and no key",
            where="sender",
            hint=f"send either sender and first, or the header {_HEADER}",
        )
    with _limit.slot():
        if numbered is not None:
            return store_batch.store_batch(library(), mission.id, records=records, place=numbered)
        return store_batch.store_keyed_batch(library(), mission.id, records=records, key=key or "")


def _numbered(given: dict[str, Any]) -> Numbered | None:
    if "sender" in given and "first" in given:
        return Numbered(given["sender"], given["first"])
    return None


robots_api = APIBlueprint(
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


@robots_api.get("/robots")
@mission_role("viewer")
@robots_api.output(RobotList)
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
