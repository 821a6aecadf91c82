"""Photos that visitors of shared maps give; they wait in the tray until somebody places or removes them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.schema import Contribution, MapRecord, Photo, Share


@dataclass(frozen=True, slots=True)
class Amount:
    """How much was given."""

    photos: int
    bytes: int


def visitor_of(share: Share, *, address: str, at: datetime) -> str:
    """Return what stands for a visitor on one day; only with the library can the address be found from it."""
    return hashlib.sha256(f"{share.token_hash} {at.date().isoformat()} {address}".encode()).hexdigest()


def of_visitor(session: Session, visitor: str) -> Amount:
    """Return how much a visitor has given on this day."""
    return _amount(session, Contribution.visitor == visitor)


def waiting_amount(session: Session, map_id: int) -> Amount:
    """Return how much of a map waits for a decision."""
    return _amount(session, *_is_waiting(map_id))


def find_waiting(session: Session, record: MapRecord, photo_id: int) -> tuple[Contribution, Photo]:
    """Find a photo that waits for a decision. Raises NotFound."""
    found = select(Contribution, Photo).where(*_is_waiting(record.id), Photo.id == photo_id)
    row = session.execute(found).first()
    if row is None:
        raise NotFound("this photo does not wait any more", hint="reload the page")
    return row[0], row[1]


def waiting(session: Session, record: MapRecord, *, most: int) -> list[tuple[Contribution, Photo]]:
    """List the photos that wait for a decision, the oldest first."""
    found = select(Contribution, Photo).where(*_is_waiting(record.id))
    rows = session.execute(found.order_by(Contribution.sent_at, Contribution.photo_id).limit(most))
    return [(contribution, photo) for contribution, photo in rows]


def to_find(session: Session, record: MapRecord) -> list[tuple[Contribution, Photo]]:
    """List the photos that wait, and for whose place the map has not been asked yet."""
    found = select(Contribution, Photo).where(*_is_waiting(record.id), Contribution.to_find)
    return [(contribution, photo) for contribution, photo in session.execute(found)]


def _is_waiting(map_id: int) -> tuple[ColumnElement[bool], ...]:
    return (
        Contribution.map_id == map_id,
        Photo.map_id == map_id,
        Photo.id == Contribution.photo_id,
        ~Photo.removed,
        Photo.x_px.is_(None),
    )


def _amount(session: Session, *conditions: ColumnElement[bool]) -> Amount:
    count, size = func.count(), func.coalesce(func.sum(Contribution.size_bytes), 0)
    found = session.execute(select(count, size).where(*conditions)).one()
    return Amount(int(found[0]), int(found[1]))
