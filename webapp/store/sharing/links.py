"""Links that open something without a sign-in: made, found by the end of their address, listed.

One system for all kinds of shares, each a table of `ShareColumns`: maps and answers (`shares.py`), missions
in their own wing.
"""

from __future__ import annotations

import secrets
from typing import TypeVar

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.accounts.accounts import hashed
from webapp.store.schema import ShareColumns

Kind = TypeVar("Kind", bound=ShareColumns)


def open_link(session: Session, share: ShareColumns, *, public: bool) -> str:
    """Store a new share under a token of its own.

    Parameters
    ----------
    session : Session
        That writes.
    share : ShareColumns
        Knows what it shows and allows; not yet in the session.
    public : bool
        Whether it is listed for everybody.

    Returns
    -------
    str
        End of its address. Of a secret one it is kept nowhere, only its hash.
    """
    token = secrets.token_urlsafe(24)
    share.token_hash = hashed(token)
    share.public_token = token if public else None
    session.add(share)
    session.flush()
    return token


def listed(session: Session, kind: type[Kind], *, where: ColumnElement[bool]) -> list[Kind]:
    """List the shares of a kind that fulfil a condition, the newest first."""
    return list(session.scalars(select(kind).where(where).order_by(kind.id.desc())))


def find(session: Session, kind: type[Kind], *, id: int, where: ColumnElement[bool]) -> Kind:
    """Find a share of a kind by its id.

    Raises
    ------
    NotFound
        There is none, or it does not fulfil the condition.
    """
    share = session.scalars(select(kind).where(kind.id == id, where)).first()
    if share is None:
        raise NotFound("there is no such link", hint="it may have been revoked: reload the page")
    return share


def by_token(session: Session, kind: type[Kind], *, token: str) -> Kind | None:
    """Find the share that the end of an address opens."""
    return session.scalars(select(kind).where(kind.token_hash == hashed(token))).first()


def not_valid() -> NotFound:
    """Make the error of a link that opens nothing: it never did, was revoked, or its target is in the bin.

    Visitors do not learn which.
    """
    return NotFound(
        "this link is not valid, or no longer valid", hint="ask the person who sent it for a new one"
    )
