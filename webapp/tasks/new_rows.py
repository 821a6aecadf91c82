"""Brings photos that lie in a map's folder already into the map, so that it can be undone."""

from __future__ import annotations

from collections.abc import Iterable

from sqlalchemy.orm import Session

from webapp.store.schema import MapRecord, Photo


def add_removed(session: Session, record: MapRecord, rows: Iterable[Photo]) -> None:
    """Add records of photos as if they had been removed: the edit that brings them back can be undone.

    Parameters
    ----------
    session : Session
        That writes.
    record : MapRecord
    rows : iterable of Photo
        With ids from `next_id` on, not yet of any map, removed.
    """
    for row in rows:
        row.map_id, row.revision = record.id, record.revision
        record.next_id = max(record.next_id, row.id + 1)
        session.add(row)
    session.flush()
