"""Ways to sign in (a one-time link, or name and password), and the browsers that are signed in."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import cache

from sqlalchemy import bindparam, delete, exists, func, or_, select
from sqlalchemy.orm import Session
from werkzeug.security import check_password_hash, generate_password_hash

from webapp.core import texts
from webapp.errors import NotFound, NotSignedIn, TooMany, UsageError
from webapp.settings import WebSettings
from webapp.store.accounts import accounts
from webapp.store.clock import now
from webapp.store.database import Database
from webapp.store.schema import Account, EndedSession, FailedSignIn, SignedIn, SignInLink

_MAX_PASSWORD = 1000
_MAX_WHO = 100

_SIGNED_IN = select(Account).where(
    Account.id == bindparam("account_id"), ~exists().where(EndedSession.id_hash == bindparam("id_hash"))
)


def new_link(session: Session, account: Account, *, hours: int) -> str:
    """Create a sign-in link for an account, and return the secret end of its URL; only its hash is stored."""
    token = secrets.token_urlsafe(24)
    session.execute(delete(SignInLink).where(SignInLink.expires_at < now() - timedelta(days=30)))
    session.add(
        SignInLink(
            token_hash=accounts.hashed(token),
            account_id=account.id,
            expires_at=now() + timedelta(hours=hours),
        )
    )
    return token


def link_account(session: Session, token: str) -> Account:
    """Return the account of a sign-in link, without using it up."""
    link = session.get(SignInLink, accounts.hashed(token))
    if link is None or link.used_at is not None or link.expires_at < now():
        raise NotSignedIn(
            "this link is no longer valid: it was used or has expired",
            hint="ask the owner of the library for a new one: expmap account link",
        )
    return session.get_one(Account, link.account_id)


def redeem_link(session: Session, token: str) -> Account:
    """Use up a sign-in link, and return its account.

    Raises:
        NotSignedIn: The link is unknown, used or expired.
    """
    account = link_account(session, token)
    session.get_one(SignInLink, accounts.hashed(token)).used_at = now()
    return account


def password_hash(password: str, *, minimum: int) -> str:
    """Hash a password; this takes a tenth of a second, so do not do it in a write transaction."""
    if not minimum <= len(password) <= _MAX_PASSWORD:
        raise UsageError(
            f"a password has at least {minimum} characters", hint="a few words are easy to remember"
        )
    return generate_password_hash(password, "scrypt")


def by_password(
    database: Database, name: str, *, password: str, address: str, limits: WebSettings
) -> Account:
    """Sign in by name and password.

    Args:
        address: Client address of the request.

    Raises:
        NotSignedIn: Wrong name or password; the error does not say which is wrong.
        TooMany: There were too many failures for this name or from this address.
    """
    with counted(database, f"name:{texts.plain(name)}", address=address, limits=limits):
        with database.read() as session:
            account = _named(session, name)
        known = account.password_hash if account is not None else None
        # An unknown name takes as long as a wrong password: the time does not reveal which names exist.
        right = check_password_hash(known or _dummy_hash(), password[: _MAX_PASSWORD + 1])
        if account is None or known is None or not right:
            raise NotSignedIn(
                "wrong name or password",
                hint="without a password, sign in by a link: expmap account link",
            )
    return account


@contextmanager
def counted(database: Database, who: str, *, address: str, limits: WebSettings) -> Iterator[None]:
    """Limit the failures of what the block checks: it fails if it raises an error.

    Args:
        who: Whose secret is tried.
        address: Client address of the request.

    Raises:
        TooMany: There were too many failures for this subject or from this address.
    """
    tried = [who[:_MAX_WHO], f"address:{address}"[:_MAX_WHO]]
    # Counted as a failure before it is checked, so that the limit holds for parallel attempts, too.
    with database.write() as session:
        _check_failures(session, tried, limits=limits)
        noted = _note_failure(session, tried, limits=limits)
    yield
    with database.write() as session:
        mine = or_(FailedSignIn.who == tried[0], FailedSignIn.id.in_(noted))
        session.execute(delete(FailedSignIn).where(mine))


def _named(session: Session, name: str) -> Account | None:
    try:
        return accounts.named(session, name)
    except NotFound:
        return None


@cache
def _dummy_hash() -> str:
    return generate_password_hash(secrets.token_hex(16), "scrypt")


def _check_failures(session: Session, tried: list[str], *, limits: WebSettings) -> None:
    window, at = timedelta(minutes=limits.sign_in_minutes), now()
    # not those that a clock set back since has put into the future: nobody would wait an hour longer
    counted = (
        select(func.count(), func.min(FailedSignIn.at))
        .where(FailedSignIn.who.in_(tried), FailedSignIn.at.between(at - window, at + window))
        .group_by(FailedSignIn.who)
    )
    waits = [
        first + window - at for count, first in session.execute(counted) if count >= limits.sign_in_failures
    ]
    if waits:
        wait_s = max(1, round(max(waits).total_seconds()))
        raise TooMany(
            "too many attempts to sign in",
            wait_s=wait_s,
            hint=f"wait {-(-wait_s // 60)} minutes, or sign in by a link",
        )


def _note_failure(session: Session, subjects: list[str], *, limits: WebSettings) -> list[int]:
    """Record a failure for each name or address; return the ids of the records."""
    old = now() - timedelta(minutes=limits.sign_in_minutes)
    session.execute(delete(FailedSignIn).where(FailedSignIn.at < old))
    rows = [FailedSignIn(who=subject) for subject in subjects]
    session.add_all(rows)
    session.flush()
    return [row.id for row in rows]


def end_session(session: Session, session_id: str, *, days: int) -> None:
    """Record that a session has been signed out.

    Args:
        session_id: As in its cookie.
        days: Validity of cookies: older records are deleted.
    """
    session.execute(delete(EndedSession).where(EndedSession.at < now() - timedelta(days=days)))
    session.merge(EndedSession(id_hash=accounts.hashed(session_id)))


def account_of_session(session: Session, session_id: str, *, account_id: int) -> Account | None:
    """Return the account of a session; None if the session was signed out or the account is gone."""
    return session.scalars(
        _SIGNED_IN, {"account_id": account_id, "id_hash": accounts.hashed(session_id)}
    ).first()


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
    """Record that a browser has signed in, and forget sessions that are over."""
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


def note_device_use(session: Session, session_id: str) -> None:
    """Record that a browser is used."""
    known = select(SignedIn).where(SignedIn.id_hash == accounts.hashed(session_id))
    row = session.scalar(known)
    if row is not None:
        row.used_at = now()


def signed_in_devices(session: Session, account: Account, *, days: int) -> list[SignedIn]:
    """List the browsers of an account that are signed in, the last used one first."""
    ended = select(EndedSession.id_hash).where(EndedSession.id_hash == SignedIn.id_hash).exists()
    found = select(SignedIn).where(
        SignedIn.account_id == account.id,
        SignedIn.epoch == account.epoch,
        SignedIn.used_at > now() - timedelta(days=days),
        ~ended,
    )
    return list(session.scalars(found.order_by(SignedIn.used_at.desc(), SignedIn.id.desc())))


def end_device(session: Session, account: Account, *, id: int) -> None:
    """Sign one browser of an account out. Raises NotFound."""
    row = session.get(SignedIn, id)
    if row is None or row.account_id != account.id:
        raise NotFound("this browser is no longer signed in", hint="reload the page")
    session.merge(EndedSession(id_hash=row.id_hash))
    session.delete(row)


def is_device_of(row: SignedIn, session_id: str) -> bool:
    return row.id_hash == accounts.hashed(session_id)
