"""Events that accounts want to hear of, kept until they are delivered.

An event is stored in the transaction of what caused it, once for each receiver that has chosen it: either
both are on disk or neither. A connection delivers them (`webapp/connect/events/`).
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from webapp.store.clock import now
from webapp.store.schema import IDS_USED_ONCE, Account, Base, Job, MapRecord, Member

ROBOT_SILENT, ROBOT_HEARD = "robot.silent", "robot.heard"
JOB_FAILED = "job.failed"
SHARE_MADE, SHARE_INVITED = "share.made", "share.invited"

EVENTS = (ROBOT_SILENT, ROBOT_HEARD, JOB_FAILED, SHARE_MADE, SHARE_INVITED)
"""What an account can choose."""

DELIVERY_JOB = "events"
"""The kind of the jobs that deliver; that one of them failed is no event."""

WAITING, SENT, GIVEN_UP = "waiting", "sent", "given up"


class EventReceiver(Base):
    """Where an account gets events: a webhook or an e-mail address."""

    __tablename__ = "event_receiver"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str]
    """`webhook` or `mail`."""
    address: Mapped[str]
    events: Mapped[list[str]]
    """Those of `EVENTS` that it gets."""
    salt: Mapped[str]
    """What its secret is derived from, with the library's key; it is no secret itself."""
    confirmed_at: Mapped[datetime | None]
    """None: whoever reads the mail has not confirmed it yet, so that it gets no events."""
    failures: Mapped[int] = mapped_column(default=0)
    """Failed tries in a row."""
    try_at: Mapped[datetime | None]
    """Earliest time of the next try; by the clock of the database."""
    created_at: Mapped[datetime] = mapped_column(default=now)


class EventDelivery(Base):
    """An event for one receiver."""

    __tablename__ = "event_delivery"
    __table_args__ = (
        Index(None, "state", "receiver_id"),
        Index(None, "receiver_id"),
        IDS_USED_ONCE,
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    receiver_id: Mapped[int] = mapped_column(ForeignKey("event_receiver.id", ondelete="CASCADE"))
    event_id: Mapped[str]
    """The same for all receivers and all tries."""
    event: Mapped[str]
    facts: Mapped[dict[str, Any]]
    at: Mapped[datetime] = mapped_column(default=now)
    state: Mapped[str] = mapped_column(default=WAITING)
    """`waiting`, `sent` or `given up`."""
    tries: Mapped[int] = mapped_column(default=0)
    ended_at: Mapped[datetime | None]
    error: Mapped[str | None]
    """Why the last try failed, as a sentence."""


def emit(
    session: Session, event: str, *, facts: Mapping[str, Any], concerns: Callable[[Account], bool]
) -> None:
    """Store an event for the receivers that have chosen it.

    Args:
        session: That of the change which is the event.
        facts: JSON values.
        concerns: Whether an account may know of it.
    """
    chosen = select(EventReceiver, Account).join(Account).where(EventReceiver.confirmed_at.is_not(None))
    id = new_id()
    for receiver, account in session.execute(chosen.order_by(EventReceiver.id)):
        if event in receiver.events and concerns(account):
            session.add(address_to(receiver, event, facts=facts, id=id))


def address_to(
    receiver: EventReceiver, event: str, *, facts: Mapping[str, Any], id: str | None = None
) -> EventDelivery:
    """Make an event for one receiver, to be added to the session."""
    return EventDelivery(receiver_id=receiver.id, event_id=id or new_id(), event=event, facts=dict(facts))


def new_id() -> str:
    return f"evt_{secrets.token_hex(12)}"


def about_map(record: MapRecord | None) -> dict[str, str] | None:
    return None if record is None else {"slug": record.slug, "name": record.name}


def owns_map(session: Session, account: Account, *, map_id: int | None) -> bool:
    """Return whether an account owns a map, or the whole library if there is no map."""
    if account.is_owner or map_id is None:
        return account.is_owner
    member = session.get(Member, (map_id, account.id))
    return member is not None and member.role == "owner"


def job_failed(session: Session, job: Job, *, error: Mapping[str, Any]) -> None:
    """Store that a job failed: for the account that wanted it; if none did, for the owners of its map."""
    if job.kind == DELIVERY_JOB:
        return

    def concerns(account: Account) -> bool:
        if job.account_id is not None:
            return account.id == job.account_id
        return owns_map(session, account, map_id=job.map_id)

    record = None if job.map_id is None else session.get(MapRecord, job.map_id)
    facts = {"job": job.id, "kind": job.kind, "map": about_map(record), **error}
    emit(session, JOB_FAILED, facts=facts, concerns=concerns)
