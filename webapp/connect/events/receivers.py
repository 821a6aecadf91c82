"""The receivers of an account: added, confirmed, changed, tried and removed."""

from __future__ import annotations

import base64
import hmac
import secrets
from collections.abc import Sequence
from pathlib import Path

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from webapp.connect.events import mail, webhook
from webapp.connect.events.messages import CONFIRM, TEST
from webapp.errors import Conflict, NotFound, UsageError
from webapp.store import outbox
from webapp.store.accounts.secret_key import derived_secret
from webapp.store.clock import now
from webapp.store.outbox import EVENTS, EventDelivery, EventReceiver
from webapp.store.schema import Account

WEBHOOK, MAIL = "webhook", "mail"
KINDS = (WEBHOOK, MAIL)
MOST = 20
"""Maximum number of receivers of an account."""

_SHOWN = 20
"""Number of an account's last messages that are listed."""

_CODE_CHARACTERS = 12


def secret_of(inner: Path, receiver: EventReceiver) -> bytes:
    """Return the secret that signs what a webhook gets; it is not stored.

    Args:
        inner: The library's folder with its key.
    """
    return derived_secret(inner, f"webhook {receiver.id} {receiver.salt}")


def code_of(inner: Path, receiver: EventReceiver) -> str:
    """Return the code that confirms an e-mail address."""
    derived = derived_secret(inner, f"mail {receiver.id} {receiver.salt}")
    return base64.b32encode(derived).decode()[:_CODE_CHARACTERS]


def list_receivers(session: Session, account_id: int) -> list[EventReceiver]:
    """List the receivers of an account, the oldest first."""
    mine = select(EventReceiver).where(EventReceiver.account_id == account_id)
    return list(session.scalars(mine.order_by(EventReceiver.id)))


def find(session: Session, account_id: int, *, id: int) -> EventReceiver:
    """Find a receiver of an account. Raises NotFound."""
    receiver = session.get(EventReceiver, id)
    if receiver is None or receiver.account_id != account_id:
        raise NotFound("receiver not found", hint="reload the page")
    return receiver


def add(
    session: Session, account: Account, *, kind: str, address: str, events: Sequence[str]
) -> EventReceiver:
    """Add a receiver; an e-mail address gets a code, and no events before it is confirmed.

    Raises:
        UsageError: The address is of another kind, an event is unknown, or there are too many receivers.
        Conflict: The account has it already.
    """
    checked = (webhook if kind == WEBHOOK else mail).check_address(address)
    there = list_receivers(session, account.id)
    if len(there) >= MOST:
        raise UsageError(f"an account has at most {MOST} receivers", hint="remove one first")
    if any((one.kind, one.address) == (kind, checked) for one in there):
        raise Conflict("this receiver is there already", hint="change its events")
    receiver = EventReceiver(
        account_id=account.id,
        kind=kind,
        address=checked,
        events=_checked(events),
        salt=secrets.token_hex(16),
        confirmed_at=now() if kind == WEBHOOK else None,
    )
    session.add(receiver)
    session.flush()
    if kind == MAIL:
        session.add(outbox.address_to(receiver, CONFIRM, facts={}))
    return receiver


def choose(receiver: EventReceiver, events: Sequence[str]) -> None:
    """Change which events a receiver gets. Raises UsageError."""
    receiver.events = _checked(events)


def confirm(inner: Path, receiver: EventReceiver, *, code: str) -> None:
    """Confirm an e-mail address by the code that it has got. Raises UsageError."""
    given = "".join(code.split()).upper()
    if not hmac.compare_digest(given.encode(), code_of(inner, receiver).encode()):
        raise UsageError("this is not the code", hint="copy it from the newest message to this address")
    receiver.confirmed_at = receiver.confirmed_at or now()


def send_test(session: Session, receiver: EventReceiver) -> None:
    """Have a test message delivered now; an unconfirmed address gets its code again."""
    event = TEST if receiver.confirmed_at is not None else CONFIRM
    waiting = select(EventDelivery.id).where(
        EventDelivery.receiver_id == receiver.id,
        EventDelivery.state == outbox.WAITING,
        EventDelivery.event == event,
    )
    if session.scalar(waiting.limit(1)) is None:
        session.add(outbox.address_to(receiver, event, facts={}))
    session.execute(update(EventReceiver).where(EventReceiver.id == receiver.id).values(try_at=None))


def last_messages(session: Session, account_id: int) -> list[tuple[EventDelivery, EventReceiver]]:
    """List the last messages to the receivers of an account, the newest first."""
    mine = select(EventDelivery, EventReceiver).join(EventReceiver)
    mine = mine.where(EventReceiver.account_id == account_id).order_by(EventDelivery.id.desc())
    return [(delivery, receiver) for delivery, receiver in session.execute(mine.limit(_SHOWN))]


def _checked(events: Sequence[str]) -> list[str]:
    unknown = sorted(set(events) - set(EVENTS))
    if unknown:
        raise UsageError("unknown event", where=unknown[0][:40], hint=f"it is one of {', '.join(EVENTS)}")
    return [event for event in EVENTS if event in events]
