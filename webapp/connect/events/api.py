"""API of the receivers of the caller's account."""

from __future__ import annotations

from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Integer, List, Nested, String
from apiflask.validators import OneOf
from flask import current_app
from flask.blueprints import BlueprintSetupState
from limits import RateLimitItemPerHour
from limits.storage import storage_from_string
from limits.strategies import FixedWindowRateLimiter

from webapp.connect.events import mail, receivers, webhook
from webapp.errors import NotReady, TooMany
from webapp.store.outbox import EVENTS, EventDelivery, EventReceiver
from webapp.web.context import account, authorized_by, library, settings
from webapp.web.counting import storage_address
from webapp.web.fields import LATER, BoundedList
from webapp.web.state import KEY

blueprint = APIBlueprint("api_account_events", __name__, url_prefix="/api/v1/account/events", tag="Accounts")

_ID = "<id:id>"
_LIMITER = "expmap_event_tests"
_TESTS_PER_HOUR = 60
_HOUR_S = 3600


class EventReceiverIn(Schema):
    """A receiver to add."""

    kind = String(required=True, validate=OneOf(receivers.KINDS))
    address = String(
        required=True, validate=LATER, metadata={"description": "URL of the webhook, or e-mail address."}
    )
    events = BoundedList(String(validate=OneOf(EVENTS)), most=len(EVENTS), required=True)


class EventReceiverChange(Schema):
    """The events that a receiver gets from now on."""

    events = BoundedList(String(validate=OneOf(EVENTS)), most=len(EVENTS), required=True)


class EventCodeIn(Schema):
    """The code that an e-mail address has got."""

    code = String(required=True, validate=LATER)


class EventReceiverOut(Schema):
    """A receiver."""

    id = Integer()
    kind = String(validate=OneOf(receivers.KINDS))
    address = String()
    events = List(String())
    confirmed = Boolean(
        metadata={"description": "Whether it gets events: an e-mail address is confirmed first."}
    )
    failures = Integer(metadata={"description": "Failed tries in a row."})
    created_at = String()


class NewEventReceiver(EventReceiverOut):
    """A new receiver."""

    secret = String(
        allow_none=True,
        metadata={"description": "Signs what a webhook gets: it is in this answer and nowhere else."},
    )


class EventMessageOut(Schema):
    """A message to a receiver."""

    id = String(metadata={"description": "The same for all receivers and all tries."})
    receiver = Integer(metadata={"description": "Id."})
    type = String()
    at = String()
    state = String(validate=OneOf(["waiting", "sent", "given up"]))
    tries = Integer()
    error = String(allow_none=True, metadata={"description": "Why the last try failed."})


class EventReceivers(Schema):
    """The receivers of the account, the oldest first, and its last messages, the newest first."""

    receivers = List(Nested(EventReceiverOut))
    messages = List(Nested(EventMessageOut))
    mail = Boolean(metadata={"description": "Whether this server sends e-mail."})


def _check(id: int) -> None:
    with library().database.read() as session:
        receivers.find(session, account().id, id=id)


_own = authorized_by(_check)


@blueprint.record_once
def _make_limiter(state: BlueprintSetupState) -> None:
    address, options = storage_address(state.app.extensions[KEY].library.database)
    state.app.extensions[_LIMITER] = FixedWindowRateLimiter(storage_from_string(address, **options))


@blueprint.get("")
@blueprint.output(EventReceivers)
def list_all() -> dict[str, Any]:
    """List where the caller gets events, and the last messages."""
    with library().database.read() as session:
        return {
            "receivers": [_receiver(one) for one in receivers.list_receivers(session, account().id)],
            "messages": [_message(*one) for one in receivers.last_messages(session, account().id)],
            "mail": mail.is_set_up(settings().mail),
        }


@blueprint.post("")
@blueprint.input(EventReceiverIn, arg_name="data")
@blueprint.output(NewEventReceiver, status_code=201)
def add(data: dict[str, Any]) -> dict[str, Any]:
    """Add a webhook or an e-mail address; the secret of a webhook is only in this response."""
    receiver, secret = add_receiver(data["kind"], data["address"], events=data["events"])
    return {**_receiver(receiver), "secret": secret}


@blueprint.patch(f"/{_ID}")
@_own
@blueprint.input(EventReceiverChange, arg_name="data")
@blueprint.output(EventReceiverOut)
def change(id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Choose which events a receiver gets."""
    with library().database.write() as session:
        receiver = receivers.find(session, account().id, id=id)
        receivers.choose(receiver, data["events"])
    return _receiver(receiver)


@blueprint.post(f"/{_ID}/confirm")
@_own
@blueprint.input(EventCodeIn, arg_name="data")
@blueprint.output(EventReceiverOut)
def confirm(id: int, data: dict[str, str]) -> dict[str, Any]:
    """Confirm an e-mail address by the code that it has got."""
    with library().database.write() as session:
        receiver = receivers.find(session, account().id, id=id)
        receivers.confirm(library().inner, receiver, code=data["code"])
    return _receiver(receiver)


@blueprint.post(f"/{_ID}/test")
@blueprint.output({}, status_code=204)
def test(id: int) -> str:
    """Have a test message sent now, or the code of an unconfirmed address again."""
    send_test(id)
    return ""


@blueprint.delete(f"/{_ID}")
@blueprint.output({}, status_code=204)
def remove(id: int) -> str:
    """Remove a receiver, and what waits for it."""
    with library().database.write() as session:
        session.delete(receivers.find(session, account().id, id=id))
    return ""


def add_receiver(kind: str, address: str, *, events: list[str]) -> tuple[EventReceiver, str | None]:
    """Add a receiver of the caller, for page and API; also return the secret of a webhook."""
    if kind == receivers.MAIL:
        if not mail.is_set_up(settings().mail):
            raise NotReady(
                "this server sends no e-mail",
                hint="its operator sets mail.host and mail.sender: docs/events.md",
            )
        mail.check_address(address)
        _count_test()
    with library().database.write() as session:
        receiver = receivers.add(session, account(), kind=kind, address=address, events=events)
    if kind == receivers.MAIL:
        return receiver, None
    return receiver, webhook.secret_text(receivers.secret_of(library().inner, receiver))


def send_test(id: int) -> None:
    """Have a test message sent, for page and API."""
    _count_test()
    with library().database.write() as session:
        receivers.send_test(session, receivers.find(session, account().id, id=id))


def _count_test() -> None:
    """Enforce the limit of messages that an account can cause by itself."""
    limiter = cast(FixedWindowRateLimiter, current_app.extensions[_LIMITER])
    if not limiter.hit(RateLimitItemPerHour(_TESTS_PER_HOUR), str(account().id)):
        raise TooMany("too many test messages", wait_s=_HOUR_S, hint="wait an hour and try again")


def _receiver(receiver: EventReceiver) -> dict[str, Any]:
    return {
        "id": receiver.id,
        "kind": receiver.kind,
        "address": receiver.address,
        "events": receiver.events,
        "confirmed": receiver.confirmed_at is not None,
        "failures": receiver.failures,
        "created_at": receiver.created_at.isoformat(timespec="seconds"),
    }


def _message(delivery: EventDelivery, receiver: EventReceiver) -> dict[str, Any]:
    return {
        "id": delivery.event_id,
        "receiver": receiver.id,
        "type": delivery.event,
        "at": delivery.at.isoformat(timespec="seconds"),
        "state": delivery.state,
        "tries": delivery.tries,
        "error": delivery.error,
    }
