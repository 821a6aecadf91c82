"""Authentication of the caller: by the session cookie of a browser, or the token of a program."""

from __future__ import annotations

import logging
import secrets
from datetime import timedelta

from flask import Flask, g, request, session
from flask_login import LoginManager, UserMixin, current_user, login_user, logout_user

from webapp.errors import NotSignedIn, StorageError
from webapp.store.accounts import accounts
from webapp.store.accounts import sign_in as ways_in
from webapp.store.clock import now
from webapp.store.schema import Account, SignedIn
from webapp.web.state import library, settings

API = "/api/"
"""Path prefix of the API, where tokens are accepted and errors are JSON."""


_ID = "session_id"
"""Key of the session's id in its cookie."""

_USE_NOTED_EVERY = timedelta(hours=1)
"""Interval at which the use of a token is recorded: not at each request, as that would be a write each."""

_log = logging.getLogger(__name__)


class User(UserMixin):  # type: ignore[misc]
    """An account in the form that Flask-Login needs."""

    def __init__(self, account: Account) -> None:
        self.account = account

    def get_id(self) -> str:
        """Return the user id of the session; it becomes invalid when the account's epoch changes."""
        return f"{self.account.id}.{self.account.epoch}"


def init_app(app: Flask) -> None:
    manager = LoginManager(app)
    manager.session_protection = None  # phones often change their IP address
    manager.user_loader(_load)


def is_api() -> bool:
    return request.path.startswith(API)


def bearer() -> str | None:
    """Return the bearer token of the request; only the API accepts tokens."""
    given = request.authorization
    return given.token if given is not None and given.type == "bearer" and is_api() else None


def signed_in() -> Account | None:
    """Return the caller's account; a token takes precedence over a session."""
    if "expmap_account" not in g:
        g.expmap_account = None  # so that the error response for an unknown token does not look it up again
        token = bearer()
        g.expmap_account = _of_session() if token is None else _of_token(token)
    found: Account | None = g.expmap_account
    return found


def assume_no_caller() -> None:
    """Treat a caller not yet looked up as unknown, for error responses while the database is unavailable."""
    g.setdefault("expmap_account", None)
    g.expmap_unread = True


def forget_caller() -> None:
    """Make `signed_in` look up the caller again."""
    g.pop("expmap_account", None)


def sign_in(account: Account) -> None:
    """Begin a new session; the data of the previous one is discarded."""
    session.clear()
    session.permanent = True
    session[_ID] = secrets.token_hex(16)
    device = ways_in.device_of(request.headers.get("User-Agent", ""))
    with library().database.write() as db:
        ways_in.note_sign_in(
            db, account, session_id=session[_ID], device=device, days=settings().web.session_days
        )
    login_user(User(account))
    g.expmap_account = account


def sign_out() -> None:
    """End the session of this browser; copies of its cookie become invalid, too."""
    if _ID in session:
        with library().database.write() as db:
            ways_in.end_session(db, session[_ID], days=settings().web.session_days)
    logout_user()
    session.clear()
    g.pop("expmap_account", None)


def _of_session() -> Account | None:
    return current_user.account if current_user.is_authenticated else None


def _of_token(token: str) -> Account:
    database = library().database
    with database.read() as db:
        found = accounts.by_token(db, token)
    if found is None:
        raise NotSignedIn(
            "unknown token", hint="make a new one on the account page, or with expmap account token"
        )
    account, known = found
    if known.used_at is None or now() - known.used_at > _USE_NOTED_EVERY:
        try:
            with database.write(locks_rows=True) as db:
                accounts.record_use(db, known.id)
        except StorageError as error:  # reading still works while writing fails
            _log.info("the use of a token was not noted: %s", error)
    return account


def _load(user_id: str) -> User | None:
    id_, _, epoch = user_id.partition(".")
    if not (id_.isdecimal() and epoch.isdecimal() and _ID in session) or "expmap_unread" in g:
        return None
    with library().database.read() as db:
        account = ways_in.account_of_session(db, session[_ID], account_id=int(id_))
        due = account is not None and ways_in.is_use_due(db, session[_ID])
    if due:
        _note_use(session[_ID])
    return User(account) if account is not None and account.epoch == int(epoch) else None


def _note_use(session_id: str) -> None:
    try:
        with library().database.write() as db:
            ways_in.note_device_use(db, session_id)
    except StorageError as error:  # reading still works while writing fails
        _log.info("the use of a session was not noted: %s", error)


def session_hash() -> str | None:
    """Return the hash of the id of this browser's session, as records have it."""
    return accounts.hashed(session[_ID]) if _ID in session else None


def is_this_browser(row: SignedIn) -> bool:
    return _ID in session and ways_in.is_device_of(row, session[_ID])
