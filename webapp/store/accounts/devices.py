"""The browsers that are signed in to an account."""

from __future__ import annotations

import re
from datetime import timedelta

from sqlalchemy import delete, or_, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.accounts import accounts
from webapp.store.clock import now
from webapp.store.schema import Account, EndedSession, SignedIn

USE_NOTED_EVERY = timedelta(hours=1)

_BROWSERS = (
    ("Edg", "Edge"),
    ("OPR", "Opera"),
    ("SamsungBrowser", "Samsung Internet"),
    ("Firefox|FxiOS", "Firefox"),
    ("Chrome|CriOS|HeadlessChrome", "Chrome"),
    ("Safari", "Safari"),
)
"""Pattern of each browser, before those whose names it also sends."""

_SYSTEMS = (
    ("Android", "Android"),
    ("iPhone", "iPhone"),
    ("iPad", "iPad"),
    ("Windows", "Windows"),
    ("Mac OS X", "macOS"),
    ("CrOS", "ChromeOS"),
    ("Linux", "Linux"),
)


def device_of(user_agent: str) -> str:
    """Return browser and system as the header `User-Agent` names them; "?" if neither is known."""
    found = (
        next((name for pattern, name in table if re.search(pattern, user_agent)), None)
        for table in (_BROWSERS, _SYSTEMS)
    )
    return " · ".join(name for name in found if name) or "?"


def note_sign_in(session: Session, account: Account, *, session_id: str, device: str, days: int) -> None:
    """Record that a browser has signed in, and forget sessions that are over.

    Args:
        days: Validity of cookies.
    """
    over = or_(
        SignedIn.used_at < now() - timedelta(days=days),
        (SignedIn.account_id == account.id) & (SignedIn.epoch != account.epoch),
    )
    session.execute(delete(SignedIn).where(over))
    session.add(
        SignedIn(
            account_id=account.id,
            id_hash=accounts.hashed(session_id),
            epoch=account.epoch,
            device=device,
        )
    )


def is_use_due(session: Session, session_id: str) -> bool:
    """Return whether a recorded browser was last seen an hour ago."""
    known = select(SignedIn.used_at).where(SignedIn.id_hash == accounts.hashed(session_id))
    used_at = session.scalar(known)
    return used_at is not None and used_at < now() - USE_NOTED_EVERY


def note_use(session: Session, session_id: str) -> None:
    """Record that a browser is used."""
    known = select(SignedIn).where(SignedIn.id_hash == accounts.hashed(session_id))
    row = session.scalar(known)
    if row is not None:
        row.used_at = now()


def signed_in(session: Session, account: Account, *, days: int) -> list[SignedIn]:
    """List the browsers of an account that are signed in, the last used one first."""
    ended = select(EndedSession.id_hash).where(EndedSession.id_hash == SignedIn.id_hash).exists()
    found = select(SignedIn).where(
        SignedIn.account_id == account.id,
        SignedIn.epoch == account.epoch,
        SignedIn.used_at > now() - timedelta(days=days),
        ~ended,
    )
    return list(session.scalars(found.order_by(SignedIn.used_at.desc(), SignedIn.id.desc())))


def end(session: Session, account: Account, *, id: int) -> None:
    """Sign one browser of an account out. Raises NotFound."""
    row = session.get(SignedIn, id)
    if row is None or row.account_id != account.id:
        raise NotFound("this browser is no longer signed in", hint="reload the page")
    session.merge(EndedSession(id_hash=row.id_hash))
    session.delete(row)


def is_of(row: SignedIn, session_id: str) -> bool:
    """Return whether a browser has the session."""
    return row.id_hash == accounts.hashed(session_id)
