"""Photos that were asked about, and the answers that were given."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.library import Library
from webapp.store.schema import Account, MapRecord, QueryRecord


def folder(library: Library, map_id: int) -> Path:
    """Name the folder with the photos that were asked about; it is no part of the map itself."""
    return library.inner / "queries" / str(map_id)


def add(session: Session, record: MapRecord, *, row: QueryRecord, most: int) -> list[QueryRecord]:
    """Remember an answer.

    Parameters
    ----------
    session : Session
        That writes.
    record : MapRecord
    row : QueryRecord
        Without map and id.
    most : int
        Answers that the map remembers.

    Returns
    -------
    list of QueryRecord
        The oldest ones, which are forgotten now: their files can go.
    """
    row.map_id = record.id
    session.add(row)
    session.flush()
    newest_first = select(QueryRecord).where(QueryRecord.map_id == record.id).order_by(QueryRecord.id.desc())
    old = list(session.scalars(newest_first.offset(most)))
    for forgotten in old:
        session.delete(forgotten)
    return old


def find(session: Session, record: MapRecord, id: int) -> QueryRecord:
    """Find an answer of a map.

    Raises
    ------
    NotFound
    """
    found = session.get(QueryRecord, id)
    if found is None or found.map_id != record.id:
        raise NotFound(f"the map has no answer {id}", hint="it may have been deleted")
    return found


def listed(
    session: Session, record: MapRecord, *, before: int | None = None, limit: int = 50
) -> list[QueryRecord]:
    """List the answers of a map, the newest first.

    Parameters
    ----------
    session : Session
    record : MapRecord
    before : int or None
        Only older ones than that one.
    limit : int
    """
    found = select(QueryRecord).where(QueryRecord.map_id == record.id)
    if before is not None:
        found = found.where(QueryRecord.id < before)
    return list(session.scalars(found.order_by(QueryRecord.id.desc()).limit(limit)))


def names(session: Session, rows: list[QueryRecord]) -> dict[int, str]:
    """Give the names of who asked, by account."""
    ids = {row.account_id for row in rows if row.account_id is not None}
    found = session.execute(select(Account.id, Account.name).where(Account.id.in_(ids)))
    return dict(found.tuples().all())
