"""Queries and their answers."""

from __future__ import annotations

from pathlib import Path
from statistics import median

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.library import Library
from webapp.store.schema import Account, MapRecord, Photo, QueryRecord, Share

_USUAL, _LEAST_USUAL = 25, 3
"""How many of the last answers the usual time is taken from, at most and at least."""


def folder(library: Library, map_id: int) -> Path:
    """Return the folder with the photos of queries, which is not part of the map itself."""
    return library.inner / "queries" / str(map_id)


def add(session: Session, record: MapRecord, *, row: QueryRecord, most: int) -> list[QueryRecord]:
    """Store an answer.

    Args:
        row: Without map and id.
        most: Number of answers that the map keeps, besides those in the next line.

    Returns:
        Older answers, now deleted; the caller can delete their files. Shared answers are kept, and those
            whose photo was added to the map and has not been removed from it.
    """
    row.map_id = record.id
    session.add(row)
    session.flush()
    shared = select(Share.query_id).where(Share.map_id == record.id, Share.query_id.is_not(None))
    there = select(Photo.id).where(Photo.map_id == record.id, ~Photo.removed)
    not_on_map = or_(QueryRecord.adopted_id.is_(None), QueryRecord.adopted_id.not_in(there))
    passing = (not_on_map, QueryRecord.id.not_in(shared))
    newest_first = (
        select(QueryRecord).where(QueryRecord.map_id == record.id, *passing).order_by(QueryRecord.id.desc())
    )
    old = list(session.scalars(newest_first.offset(most)))
    for forgotten in old:
        session.delete(forgotten)
    return old


def find(session: Session, record: MapRecord, id: int) -> QueryRecord:
    """Find an answer of a map. Raises NotFound."""
    found = session.get(QueryRecord, id)
    if found is None or found.map_id != record.id:
        raise NotFound(f"the map has no answer {id}", hint="it may have been deleted")
    return found


def keyed(session: Session, record: MapRecord, *, key: str | None, account_id: int) -> QueryRecord | None:
    """Find the answer to an earlier query with the same key; None for a new one."""
    mine = (QueryRecord.map_id == record.id, QueryRecord.account_id == account_id, QueryRecord.key == key)
    return None if key is None else session.scalars(select(QueryRecord).where(*mine)).first()


def list_queries(
    session: Session, record: MapRecord, *, before: int | None = None, limit: int = 50
) -> list[QueryRecord]:
    """List the answers of a map, newest first."""
    found = select(QueryRecord).where(QueryRecord.map_id == record.id)
    if before is not None:
        found = found.where(QueryRecord.id < before)
    return list(session.scalars(found.order_by(QueryRecord.id.desc()).limit(limit)))


def usual_seconds(session: Session, record: MapRecord) -> float | None:
    """Return the median time that the last answers of a map took; None if there are fewer than three."""
    last = select(QueryRecord.answer).where(QueryRecord.map_id == record.id)
    found = session.scalars(last.order_by(QueryRecord.id.desc()).limit(_USUAL))
    times = [answer["seconds"]["total"] for answer in found if (answer.get("seconds") or {}).get("total")]
    return median(times) if len(times) >= _LEAST_USUAL else None


def answers(
    session: Session,
    record: MapRecord,
    *,
    first: int | None = None,
    last: int | None = None,
    account_id: int | None = None,
) -> list[QueryRecord]:
    """List the answers of a map between two ids, inclusive, oldest first; None leaves an end open."""
    found = select(QueryRecord).where(QueryRecord.map_id == record.id)
    if first is not None:
        found = found.where(QueryRecord.id >= first)
    if last is not None:
        found = found.where(QueryRecord.id <= last)
    if account_id is not None:
        found = found.where(QueryRecord.account_id == account_id)
    return list(session.scalars(found.order_by(QueryRecord.id)))


def adopted(session: Session, record: MapRecord) -> list[tuple[Photo, QueryRecord, int]]:
    """List the photos on a map that were queries before; none if the map does not use them.

    Returns:
        By id; with each, its answer, and the id from which on photos were added after that.
    """
    if not record.uses_adopted:
        return []
    newer = select(func.min(Photo.id)).where(Photo.map_id == record.id, Photo.uploaded_at >= QueryRecord.at)
    placed = (Photo.map_id == record.id, Photo.x_px.is_not(None), ~Photo.removed)
    found = session.execute(
        select(Photo, QueryRecord, newer.correlate(QueryRecord).scalar_subquery())
        .join(QueryRecord, QueryRecord.adopted_id == Photo.id)
        .where(QueryRecord.map_id == record.id, *placed)
        .order_by(Photo.id, QueryRecord.id.desc())
    )
    return [
        *{
            photo.id: (photo, query, record.next_id if newer is None else newer)
            for photo, query, newer in found
        }.values()
    ]


def names(session: Session, rows: list[QueryRecord]) -> dict[int, str]:
    ids = {row.account_id for row in rows if row.account_id is not None}
    found = session.execute(select(Account.id, Account.name).where(Account.id.in_(ids)))
    return dict(found.all())
