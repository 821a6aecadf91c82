"""Delivers the events of a receiver.

A receiver that fails is tried again after a pause that doubles up to an hour, and its events are given up a
day after they happened. What was sent is recorded after the receiver has accepted it: a worker that is killed
in between sends it again, with the same id.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from webapp.connect.events import mail, messages, receivers, webhook
from webapp.connect.events.due import LONGEST_PAUSE
from webapp.errors import ExpMapError
from webapp.jobs.context import Context
from webapp.settings import Settings
from webapp.store import outbox
from webapp.store.clock import now
from webapp.store.database import moment
from webapp.store.outbox import EventDelivery, EventReceiver
from webapp.store.schema import Account

_FIRST_PAUSE = timedelta(seconds=5)

_log = logging.getLogger(__name__)


def deliver(context: Context) -> Mapping[str, Any]:
    """Send what waits for the receiver of the argument `receiver`, oldest first, until a try fails."""
    id, sent = int(context.arguments["receiver"]), 0
    while (error := _deliver_next(context, id)) == "":
        sent += 1
    return {"sent": sent, "error": error}


def _deliver_next(context: Context, receiver_id: int) -> str | None:
    """Send one event; returns why that failed, nothing if it was sent, None if none is waiting."""
    context.progress.check()
    with context.library.database.read() as session:
        found = _next(session, receiver_id)
    if found is None:
        return None
    receiver, account, delivery = found
    try:
        _send(context, receiver, delivery, language=account.language)
        error = ""
    except ExpMapError as failure:
        error = failure.message if failure.hint is None else f"{failure.message} ({failure.hint})"
    except Exception:  # noqa: BLE001 - another receiver's events must not wait for a mistake here
        _log.exception("event %s could not be delivered", delivery.event_id)
        error = "internal error: the server's log has the details"
    with context.write() as session:
        _record(session, receiver, delivery, error=error, settings=context.settings)
    return error


def _next(session: Session, receiver_id: int) -> tuple[EventReceiver, Account, EventDelivery] | None:
    waiting = (
        select(EventReceiver, Account, EventDelivery)
        .join(Account, Account.id == EventReceiver.account_id)
        .join(EventDelivery, EventDelivery.receiver_id == EventReceiver.id)
        .where(EventReceiver.id == receiver_id, EventDelivery.state == outbox.WAITING)
    )
    row = session.execute(waiting.order_by(EventDelivery.id).limit(1)).first()
    return None if row is None else (row[0], row[1], row[2])


def _send(
    context: Context, receiver: EventReceiver, delivery: EventDelivery, *, language: str | None
) -> None:
    inner, settings = context.library.inner, context.settings
    site = settings.events.site
    if receiver.kind == receivers.WEBHOOK:
        secret = receivers.secret_of(inner, receiver)
        content = messages.content(delivery, site=site)
        webhook.post(receiver.address, content, secret=secret, settings=settings.events)
        return
    subject, text = messages.subject_and_text(
        delivery, language=language, site=site, code=receivers.code_of(inner, receiver)
    )
    message = mail.compose(settings.mail, receiver.address, subject=subject, text=text, id=delivery.event_id)
    mail.send(settings.mail, message, timeout_s=settings.events.timeout_s)


def _record(
    session: Session,
    receiver: EventReceiver,
    delivery: EventDelivery,
    *,
    error: str,
    settings: Settings,
) -> None:
    """Record how a try ended, unless receiver or event were deleted meanwhile."""
    kept = session.get(EventReceiver, receiver.id)
    tried = session.get(EventDelivery, delivery.id)
    if kept is None or tried is None:
        return
    tried.tries += 1
    if not error:
        tried.state, tried.ended_at, tried.error = outbox.SENT, now(), None
        kept.failures, kept.try_at = 0, None
        return
    tried.error = error
    pause = min(_FIRST_PAUSE * 2.0 ** min(kept.failures, 20), LONGEST_PAUSE)
    kept.failures, kept.try_at = kept.failures + 1, moment(session) + pause
    session.flush()
    session.execute(
        update(EventDelivery)
        .where(
            EventDelivery.receiver_id == kept.id,
            EventDelivery.state == outbox.WAITING,
            EventDelivery.at < now() - timedelta(hours=settings.events.give_up_h),
        )
        .values(state=outbox.GIVEN_UP, ended_at=now(), error=error)
    )
