"""Phones in a mission: their links, and the positions that they send by them, without an account."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import partial
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import Length, Range
from flask import Response, jsonify, request, url_for
from sqlalchemy.orm import Session

from webapp.missions.core import phone_positions
from webapp.missions.store import missions, phones
from webapp.missions.store.batches import OutOfOrder
from webapp.missions.store.phones import OpenedPhone
from webapp.missions.store.schema import MissionPhone
from webapp.missions.tasks import store_batch
from webapp.missions.web.api_batches import BatchOut, answer_out_of_order
from webapp.missions.web.context import mission_role, open_mission
from webapp.render.qr import qr_path
from webapp.store.clock import now
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, authorized_by, library, public
from webapp.web.fields import LATER, BoundedList, JsonValue, RecordNumber

phones_api = APIBlueprint(
    "api_phones", __name__, url_prefix="/api/v1/missions/<id:mission_id>/phones", tag="Missions"
)
positions_api = APIBlueprint(
    "api_phone_positions", __name__, url_prefix="/api/v1/phones/<token>", tag="Missions"
)

_MOST_POSITIONS = 500
_MOST_BYTES = 200_000
_OWNTRACKS_HTTP = 3
_NO_COMMANDS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "An empty list: there are no commands for the app.",
        "content": {"application/json": {"schema": {"type": "array", "items": {"type": "object"}}}},
    }
}

OPERATIONS = {"api_phones.list_phones": {"statuses": [403]}}

_limit = ConcurrencyLimit("phones", share=0.5)
positions_api.record(_limit.set_up)


class PhoneIn(Schema):
    """A new phone."""

    name = String(required=True, validate=LATER, metadata={"description": "Of the person; its track has it."})


class PhoneOut(Schema):
    """A phone that may send positions to the mission."""

    id = Integer()
    name = String()
    created_at = String()
    heard_at = String(allow_none=True, metadata={"description": "When it last sent something."})
    positions = Integer(metadata={"description": "How many it has sent."})


class QrOut(Schema):
    """A QR code, as the `d` of an SVG path; its modules are squares of 1 with a quiet zone of 4."""

    size = Integer()
    path = String()


class NewPhoneOut(PhoneOut):
    """The answer to a new phone, the only one with its addresses."""

    url = String(metadata={"description": "A page that sends the position of the phone that opens it."})
    qr = Nested(QrOut, metadata={"description": "The same as a QR code."})
    owntracks = String(metadata={"description": "Address for OwnTracks in HTTP mode."})
    owntracks_setup = String(metadata={"description": "A link that sets OwnTracks up, opened on the phone."})
    gpslogger = String(metadata={"description": "Address for GPSLogger, Traccar Client and OsmAnd."})


class PhoneList(Schema):
    """The phones of a mission, by name; `now` is the server's clock."""

    phones = List(Nested(PhoneOut))
    now = String()


class PositionIn(Schema):
    """A position of a phone."""

    time = Float(required=True, metadata={"description": "Unix seconds, UTC."})
    lat = Float(required=True, validate=Range(-90, 90))
    lon = Float(required=True, validate=Range(-180, 180))
    height_m = Float(load_default=None, allow_none=True)
    accuracy_m = Float(
        load_default=None,
        allow_none=True,
        validate=Range(0, 1e6),
        metadata={"description": "Radius that holds 68 %, metres."},
    )


class PositionsIn(Schema):
    """Positions in their order, numbered by the sender as the records of a robot."""

    sender = String(
        required=True, validate=Length(8, 64), metadata={"description": "A random name of this installation."}
    )
    first = RecordNumber(required=True, strict=True, metadata={"description": "Number of the first one."})
    positions = BoundedList(Nested(PositionIn), required=True, most=_MOST_POSITIONS)


def _value() -> JsonValue:
    return JsonValue(bytes=100, values=1, load_default=None)


class OwnTracksIn(Schema):
    """A message of OwnTracks; what is not a position is accepted and left out."""

    class Meta:
        """There are more fields than these."""

        unknown = "exclude"

    _type = String(
        required=True, validate=Length(max=40), metadata={"description": "`location`, or another."}
    )
    lat = _value()
    lon = _value()
    alt = _value()
    tst = _value()
    acc = _value()
    batt = _value()


def _opened(token: str) -> OpenedPhone:
    with library().database.read() as session:
        return phones.open_phone(session, token)


_by_link = authorized_by(lambda token, **_: _opened(token))


@phones_api.get("")
@mission_role("editor")
@phones_api.output(PhoneList)
def list_phones(mission_id: int) -> dict[str, Any]:
    """List the phones of a mission."""
    mission = open_mission(mission_id, "editor")
    with library().database.read() as session:
        found = [_phone_json(phone) for phone in phones.list_phones(session, mission)]
    return {"phones": found, "now": now().isoformat(timespec="seconds")}


@phones_api.post("")
@mission_role("editor")
@phones_api.input(PhoneIn, arg_name="given")
@phones_api.output(NewPhoneOut, status_code=201)
def add(mission_id: int, *, given: dict[str, str]) -> dict[str, Any]:
    """Make a link by which a phone sends positions; its addresses are returned only here."""
    mission, who = open_mission(mission_id, "editor"), account()
    with library().database.write() as session:
        missions.find(session, mission.id, account=who, role="editor")  # it may have been moved
        phone, token = phones.create(session, mission, name=given["name"], account_id=who.id)
        form = _phone_json(phone)
    url = url_for("phone_pages.send_positions", token=token, _external=True)
    owntracks = url_for("api_phone_positions.receive_owntracks", token=token, _external=True)
    return form | {
        "url": url,
        "qr": qr_path(url),
        "owntracks": owntracks,
        "owntracks_setup": _owntracks_setup(owntracks),
        "gpslogger": url_for("api_phone_positions.receive_parameters", token=token, _external=True),
    }


@phones_api.delete("/<id:id>")
@mission_role("editor")
@phones_api.output({}, status_code=204)
def remove(mission_id: int, id: int) -> str:
    """Remove a phone: its link stops working, its track stays."""
    mission = open_mission(mission_id, "editor")
    with library().database.write() as session:
        phones.remove(session, mission, id=id)
    return ""


@positions_api.before_request
def limit_bytes() -> None:
    """Limit the size of messages."""
    request.max_content_length = _MOST_BYTES


@positions_api.errorhandler(OutOfOrder)
def continue_from(error: OutOfOrder) -> Response:
    """Answer with the number to continue from."""
    return answer_out_of_order(error)


@positions_api.post("/positions")
@public
@_by_link
@positions_api.input(PositionsIn, arg_name="given")
@positions_api.output(BatchOut)
@positions_api.doc(
    description="All positions are stored, or none, and each once, however often it is sent. Positions after "
    "a gap are answered by 409 with `error.next`."
)
def receive(token: str, *, given: dict[str, Any]) -> dict[str, Any]:
    """Send positions of a phone."""
    opened = _opened(token)
    records = [phone_positions.pose(one, track=opened.phone.name) for one in given["positions"]]
    place = store_batch.Numbered(f"phone:{opened.phone.id}:{given['sender']}", given["first"])
    also = partial(_count, opened.phone)
    with _limit.slot():
        return store_batch.store_batch(library(), opened.mission.id, records=records, place=place, also=also)


@positions_api.post("/owntracks")
@public
@_by_link
@positions_api.input(OwnTracksIn, arg_name="given")
@positions_api.doc(responses=_NO_COMMANDS)
def receive_owntracks(token: str, *, given: dict[str, Any]) -> Response:
    """Send a message of OwnTracks in HTTP mode."""
    _store_one(_opened(token), phone_positions.from_owntracks(given))
    return jsonify([])


@positions_api.get("/track")
@public
@_by_link
@positions_api.output({}, status_code=204)
def receive_parameters(token: str) -> str:
    """Send a position in the address: `?lat=50.1&lon=14.4&time=2026-05-01T10:00:00Z&acc=8&alt=210`.

    For apps that can do no more: GPSLogger, Traccar Client, OsmAnd. Times are ISO 8601 with an offset, Unix
    seconds or milliseconds. The answer is empty.
    """
    _store_one(_opened(token), phone_positions.from_parameters(request.args))
    return ""


@positions_api.post("/track")
@public
@_by_link
@positions_api.output({}, status_code=204)
def receive_form(token: str) -> str:
    """Send a position as a form, with the fields that the address has otherwise."""
    _store_one(_opened(token), phone_positions.from_parameters({**request.args, **request.form}))
    return ""


def _store_one(opened: OpenedPhone, values: dict[str, Any] | None) -> None:
    """Store a position of an app, which has no numbers: the same one again is not stored."""
    if values is None:
        return
    records = phone_positions.records(values, track=opened.phone.name)
    digest = hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()
    with _limit.slot():
        store_batch.store_keyed_batch(
            library(),
            opened.mission.id,
            records=records,
            key=f"phone:{opened.phone.id}:{digest}",
            also=lambda session, _: phones.note_positions(session, opened.phone, count=1),
        )


def _count(phone: MissionPhone, session: Session, count: int) -> None:
    phones.note_positions(session, phone, count=count)


def _phone_json(phone: MissionPhone) -> dict[str, Any]:
    heard = phone.heard_at
    return {
        "id": phone.id,
        "name": phone.name,
        "created_at": phone.created_at.isoformat(timespec="seconds"),
        "heard_at": None if heard is None else heard.isoformat(timespec="seconds"),
        "positions": phone.positions,
    }


def _owntracks_setup(url: str) -> str:
    """Return the address that configures OwnTracks (https://owntracks.org/booklet/features/remoteconfig/)."""
    configuration = {"_type": "configuration", "mode": _OWNTRACKS_HTTP, "url": url}
    encoded = base64.b64encode(json.dumps(configuration).encode()).decode()
    return f"owntracks:///config?inline={encoded}"
