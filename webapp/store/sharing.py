"""Views that are open without a sign-in: maps and answers, and the links that every kind of share has.

One system for all kinds of shares, each a table of `ShareColumns`: maps and answers here, missions in their
own wing.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TypeVar

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store import queries
from webapp.store.accounts.accounts import hashed
from webapp.store.schema import Account, Base, MapRecord, QueryRecord, Share, ShareColumns

Kind = TypeVar("Kind", bound=ShareColumns)


@dataclass(frozen=True, slots=True)
class Allows:
    """What a share gives besides the image, the dots, and the answer that it is about.

    Attributes
    ----------
    photos : bool
        Previews of photos.
    localize : bool
        Questions about photos of the visitor's own; of a shared map only.
    originals : bool
        Original files, with their EXIF.
    notes : bool
        Notes on photos and on spots of the map; of a shared map only.
    landmarks : bool
        The map in 3D, landmarks and the cameras of its photos; of a shared map only.
    """

    photos: bool = False
    localize: bool = False
    originals: bool = False
    notes: bool = False
    landmarks: bool = False


@dataclass(frozen=True, slots=True)
class OpenedShare:
    """What a visitor sees; records of a session that is closed.

    Attributes
    ----------
    query : QueryRecord or None
        The only answer that is shown; None for a whole map.
    """

    share: Share
    map: MapRecord
    query: QueryRecord | None


def create(
    session: Session,
    record: MapRecord,
    *,
    allows: Allows,
    account_id: int,
    query_id: int | None = None,
    public: bool = False,
) -> tuple[Share, str]:
    """Share a map or one answer; also returns the token, as `open_link` does.

    Parameters
    ----------
    query_id : int or None
        The answer; None for the map.

    Raises
    ------
    NotFound
        The map does not have this answer.
    """
    if query_id is not None:
        queries.find(session, record, query_id)
    share = Share(map_id=record.id, query_id=query_id, account_id=account_id)
    change(share, allows)
    return share, open_link(session, share, public=public)


def change(share: Share, allows: Allows) -> None:
    """Let a share give more, or less."""
    share.photos = allows.photos
    share.localize = allows.localize and share.query_id is None
    share.originals = allows.originals
    share.notes = allows.notes and share.query_id is None
    share.landmarks = allows.landmarks and share.query_id is None


def list_shares(session: Session, record: MapRecord) -> list[Share]:
    """List the shares of a map and of its answers, the newest first."""
    return shares_of(session, Share, where=Share.map_id == record.id)


def find(session: Session, record: MapRecord, id: int) -> Share:
    """Find a share of a map.

    Raises
    ------
    NotFound
    """
    return find_share(session, Share, id=id, where=Share.map_id == record.id)


def open_share(session: Session, token: str) -> OpenedShare:
    """Find what the end of an address opens.

    Raises
    ------
    NotFound
        It opens nothing, or the map is in the bin.
    """
    share = share_by_token(session, Share, token=token)
    record = None if share is None else session.get_one(MapRecord, share.map_id)
    if share is None or record is None or record.binned_at is not None:
        raise link_not_valid()
    query = None if share.query_id is None else session.get_one(QueryRecord, share.query_id)
    return OpenedShare(share, record, query)


def public(session: Session) -> list[OpenedShare]:
    """List what is open to everybody, the newest first."""
    found = (
        select(Share, MapRecord, QueryRecord)
        .join(MapRecord, MapRecord.id == Share.map_id)
        .outerjoin(QueryRecord, QueryRecord.id == Share.query_id)
        .where(Share.public_token.is_not(None), MapRecord.binned_at.is_(None))
        .order_by(Share.id.desc())
    )
    return [OpenedShare(*row) for row in session.execute(found)]


def open_link(session: Session, share: ShareColumns, *, public: bool) -> str:
    """Store a new share under a token of its own.

    Parameters
    ----------
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


def shares_of(session: Session, kind: type[Kind], *, where: ColumnElement[bool]) -> list[Kind]:
    """List the shares of a kind that fulfil a condition, the newest first."""
    return list(session.scalars(select(kind).where(where).order_by(kind.id.desc())))


def maker_of(session: Session, share: ShareColumns) -> str | None:
    """Return the name of who made a share; None where that account was removed."""
    account = None if share.account_id is None else session.get(Account, share.account_id)
    return None if account is None else account.name


def shares_of_removed_accounts(session: Session) -> list[ShareColumns]:
    """List the shares of every kind that are open although who made them has no account any more."""
    kinds = [mapper.class_ for mapper in Base.registry.mappers if issubclass(mapper.class_, ShareColumns)]
    return [share for kind in kinds for share in shares_of(session, kind, where=kind.account_id.is_(None))]


def revoke_of_removed_accounts(session: Session) -> int:
    """Revoke the shares whose makers have no account any more; returns how many."""
    found = shares_of_removed_accounts(session)
    for share in found:
        session.delete(share)
    return len(found)


def find_share(session: Session, kind: type[Kind], *, id: int, where: ColumnElement[bool]) -> Kind:
    """Find a share of a kind by its id.

    Raises
    ------
    NotFound
        There is none, or it does not fulfil the condition.
    """
    share = session.scalars(select(kind).where(kind.id == id, where)).first()
    if share is None:
        raise NotFound("link not found", hint="it may have been revoked: reload the page")
    return share


def share_by_token(session: Session, kind: type[Kind], *, token: str) -> Kind | None:
    """Find the share that the end of an address opens."""
    return session.scalars(select(kind).where(kind.token_hash == hashed(token))).first()


def link_not_valid() -> NotFound:
    """Make the error of a link that opens nothing: it never did, was revoked, or its target is in the bin.

    Visitors do not learn which.
    """
    return NotFound(
        "this link is not valid, or no longer valid", hint="ask the person who sent it for a new one"
    )
