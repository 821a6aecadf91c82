"""Views that are open without signing in: shares of maps and answers, and the links of all kinds of shares.

All kinds of shares work alike; each is a table with `ShareColumns`. Shares of missions are in their own
package.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TypeVar

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store import outbox, queries
from webapp.store.accounts.accounts import hashed
from webapp.store.schema import Account, Base, MapRecord, QueryRecord, Share, ShareColumns

Kind = TypeVar("Kind", bound=ShareColumns)


@dataclass(frozen=True, slots=True)
class SharePermissions:
    """What a share allows, besides the image, the dots, and the answer that it is about."""

    photos: bool = False  # Previews of photos
    localize: bool = False  # Localization of visitors' own photos; for a shared map only
    originals: bool = False  # Original files, with their EXIF
    notes: bool = False  # Notes on photos and on spots of the map; for a shared map only
    landmarks: bool = False  # The map in 3D, landmarks and the cameras of its photos; for a shared map only
    contribute: bool = False  # Photos that visitors give to the map; for a shared map only


@dataclass(frozen=True, slots=True)
class OpenedShare:
    """The content of a share; its records outlive their session."""

    share: Share
    map: MapRecord
    query: QueryRecord | None  # The only answer that is shown; None for a whole map


def create(
    session: Session,
    record: MapRecord,
    *,
    allows: SharePermissions,
    account_id: int,
    query_id: int | None = None,
    public: bool = False,
) -> tuple[Share, str]:
    """Share a map or one answer; also return the token, like `open_link`."""
    if query_id is not None:
        queries.find(session, record, query_id)
    share = Share(map_id=record.id, query_id=query_id, account_id=account_id)
    change(share, allows)
    token = open_link(session, share, public=public)
    facts = {
        "map": outbox.about_map(record),
        "answer": query_id,
        "public": public,
        "by": creator_of(session, share),
    }
    outbox.emit(
        session,
        outbox.SHARE_MADE,
        facts=facts,
        concerns=lambda account: outbox.owns_map(session, account, map_id=record.id),
    )
    return share, token


def change(share: Share, allows: SharePermissions) -> None:
    share.photos = allows.photos
    share.localize = allows.localize and share.query_id is None
    share.originals = allows.originals
    share.notes = allows.notes and share.query_id is None
    share.landmarks = allows.landmarks and share.query_id is None
    share.contribute = allows.contribute and share.query_id is None


def list_shares(session: Session, record: MapRecord) -> list[Share]:
    """List the shares of a map and of its answers, newest first."""
    return shares_of(session, Share, where=Share.map_id == record.id)


def find(session: Session, record: MapRecord, id: int) -> Share:
    """Find a share of a map. Raises NotFound."""
    return find_share(session, Share, id=id, where=Share.map_id == record.id)


def open_share(session: Session, token: str) -> OpenedShare:
    """Find the share of a token.

    Raises:
        NotFound: There is none, or the map is in the bin.
    """
    share = share_by_token(session, Share, token=token)
    record = None if share is None else session.get_one(MapRecord, share.map_id)
    if share is None or record is None or record.binned_at is not None:
        raise link_not_valid()
    query = None if share.query_id is None else session.get_one(QueryRecord, share.query_id)
    return OpenedShare(share, record, query)


def public(session: Session) -> list[OpenedShare]:
    """List the publicly listed shares, newest first."""
    found = (
        select(Share, MapRecord, QueryRecord)
        .join(MapRecord, MapRecord.id == Share.map_id)
        .outerjoin(QueryRecord, QueryRecord.id == Share.query_id)
        .where(Share.public_token.is_not(None), MapRecord.binned_at.is_(None))
        .order_by(Share.id.desc())
    )
    return [OpenedShare(*row) for row in session.execute(found)]


def open_link(session: Session, share: ShareColumns, *, public: bool) -> str:
    """Store a new share under a new token.

    Args:
        share: With its target and permissions; not yet in the session.

    Returns:
        The token, which is the end of its URL. For a secret share, only its hash is stored.
    """
    token = secrets.token_urlsafe(24)
    share.token_hash = hashed(token)
    share.public_token = token if public else None
    session.add(share)
    session.flush()
    return token


def shares_of(session: Session, kind: type[Kind], *, where: ColumnElement[bool]) -> list[Kind]:
    """List the shares of a kind that fulfil a condition, newest first."""
    return list(session.scalars(select(kind).where(where).order_by(kind.id.desc())))


def creator_of(session: Session, share: ShareColumns) -> str | None:
    """Return the name of the account that made a share; None if it was removed."""
    account = None if share.account_id is None else session.get(Account, share.account_id)
    return None if account is None else account.name


def shares_of_removed_accounts(session: Session) -> list[ShareColumns]:
    """List the shares, of every kind, that are still open although their makers' accounts were removed."""
    kinds = [mapper.class_ for mapper in Base.registry.mappers if issubclass(mapper.class_, ShareColumns)]
    return [share for kind in kinds for share in shares_of(session, kind, where=kind.account_id.is_(None))]


def revoke_of_removed_accounts(session: Session) -> int:
    """Revoke the shares whose makers' accounts were removed; return their number."""
    found = shares_of_removed_accounts(session)
    for share in found:
        session.delete(share)
    return len(found)


def find_share(session: Session, kind: type[Kind], *, id: int, where: ColumnElement[bool]) -> Kind:
    """Find a share of a kind by its id."""
    share = session.scalars(select(kind).where(kind.id == id, where)).first()
    if share is None:
        raise NotFound("link not found", hint="it may have been revoked: reload the page")
    return share


def share_by_token(session: Session, kind: type[Kind], *, token: str) -> Kind | None:
    """Find the share of a token; None if there is none."""
    return session.scalars(select(kind).where(kind.token_hash == hashed(token))).first()


def link_not_valid() -> NotFound:
    """Return the error for a link that never existed, was revoked, or whose target is in the bin.

    It does not reveal which.
    """
    return NotFound(
        "this link is not valid, or no longer valid", hint="ask the person who sent it for a new one"
    )
