"""The context of a request: library, settings, caller and map; and the marking of public views."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from flask import Flask, copy_current_request_context, current_app, request
from sqlalchemy.orm import Session

from webapp.errors import NotFound, NotSignedIn, UsageError
from webapp.store.maps import maps
from webapp.store.maps.maps import Role
from webapp.store.schema import Account, MapRecord
from webapp.web.accounts import sessions
from webapp.web.state import library as library
from webapp.web.state import settings as settings

View = TypeVar("View", bound=Callable[..., Any])

_MARK = "expmap_public"
_RIGHT = "expmap_right"
_PUBLIC_ENDPOINTS = frozenset({"static", "openapi.spec"})
"""Public endpoints registered by libraries; they return no user data."""


def account() -> Account:
    """Return the caller's account.

    Raises:
        NotSignedIn: The caller is not signed in: the API answers 401, pages redirect to the sign-in.
    """
    found = sessions.signed_in()
    if found is None:
        raise NotSignedIn("you are not signed in", hint="sign in, or send a token: Authorization: Bearer ...")
    return found


def open_map(slug: str, role: Role = "viewer", *, binned: bool = False) -> MapRecord:
    """Find a map on which the caller has a role. Raises NotSignedIn, NotFound, NotAllowed.

    Args:
        role: The required role: `viewer`, `editor` or `owner`.
        binned: Whether a map in the bin is accepted.

    Returns:
        Detached, as its session is closed: only for reading its fields.
    """
    with reading_map(slug, role, binned=binned) as (_, record):
        return record


@contextmanager
def reading_map(
    slug: str, role: Role = "viewer", *, binned: bool = False
) -> Iterator[tuple[Session, MapRecord]]:
    """Find a map as `open_map` does, and yield it with its session for further reading.

    After the block the record is detached: only for reading its fields. Raises NotSignedIn, NotFound,
    NotAllowed.
    """
    who = account()
    with library().database.read() as session:
        record = maps.find(session, slug, account=who, role=role)
        if record.binned_at is not None and not binned:
            raise NotFound("this map is in the bin", where=slug, hint="restore it from the bin first")
        yield session, record


def if_match() -> int | None:
    """Return the latest revision the caller knows, from the header `If-Match`; ETag quotes are allowed."""
    text = request.headers.get("If-Match")
    if text is None:
        return None
    number = text.strip().strip('"')
    if not number.isdecimal():
        raise UsageError(
            f"{text!r} is not a revision", where="If-Match", hint="send the revision of the last answer"
        )
    return int(number)


def public(view: View) -> View:
    """Mark a view as public, without sign-in; a decorator to be placed directly below the route."""
    setattr(view, _MARK, True)
    return view


def is_public(view: Callable[..., Any]) -> bool:
    return bool(getattr(view, _MARK, False))


def authorized_by(check: Callable[..., object]) -> Callable[[View], View]:
    """Have the caller's right checked before the body is read; a decorator to be placed as `public` is.

    Args:
        check: Gets the variable parts of the URL by name; raises NotFound or NotAllowed.
    """

    def mark(view: View) -> View:
        setattr(view, _RIGHT, check)
        return view

    return mark


def may_share(record: MapRecord) -> bool:
    """Return whether the caller, who may be nobody, is an owner of a map."""
    who = sessions.signed_in()
    if who is None:
        return False
    with library().database.read() as session:
        return maps.role_of(session, record, account=who) == "owner"


def map_role(role: Role) -> Callable[[View], View]:
    """Have the caller's role on the map of the URL checked before the body is read."""
    return authorized_by(lambda slug, **_: open_map(slug, role))


def checked_right(view: Callable[..., Any]) -> Callable[..., object] | None:
    found: Callable[..., object] | None = getattr(view, _RIGHT, None)
    return found


def repeated_check() -> Callable[[], None]:
    """Return a function that checks the caller's right again, also while the response is streamed.

    The view is marked by `authorized_by`. The account or its session, the role or the link may have ended:
    the function raises NotSignedIn, NotFound or NotAllowed.
    """
    assert checked_right(current_app.view_functions[request.endpoint or ""]) is not None
    return copy_current_request_context(_check)


def init_app(app: Flask) -> None:
    """Register the authentication and authorization of every request, before its body is read."""
    app.before_request(_check)
    app.add_template_global(may_share)


def _check() -> None:
    endpoint = request.endpoint
    if endpoint is None or endpoint in _PUBLIC_ENDPOINTS:
        return
    view = current_app.view_functions[endpoint]
    if not is_public(view):
        account()
    check = checked_right(view)
    if check is not None:
        check(**(request.view_args or {}))
