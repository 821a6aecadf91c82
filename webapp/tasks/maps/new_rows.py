"""Records of photos that lie in a map's folder already: read once, and brought into the map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sqlalchemy.orm import Session

from webapp.core.mapmodel.model import Experience
from webapp.settings import PhotoLimits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.adopt_map import photo_row


class PhotoFiles:
    """Photos of a map's folder, each read once: the second time it takes no time, and no lock waits for it.

    Parameters
    ----------
    cfg : Path
        Of the map.
    """

    def __init__(self, cfg: Path, limits: PhotoLimits) -> None:
        self._cfg, self._limits = cfg, limits
        self._read: dict[Experience, tuple[Photo, str | None]] = {}

    def row(self, experience: Experience) -> tuple[Photo, str | None]:
        """Make a new record of an experience's photo, as `adopt_map.photo_row` does."""
        if experience not in self._read:
            self._read[experience] = photo_row(self._cfg, experience, limits=self._limits)
        row, problem = self._read[experience]
        return Photo(**{column.key: getattr(row, column.key) for column in Photo.__table__.columns}), problem


def add_removed(session: Session, record: MapRecord, rows: Iterable[Photo]) -> None:
    """Add records of photos as if they had been removed: the edit that brings them back can be undone.

    Parameters
    ----------
    session : Session
        That writes.
    rows : iterable of Photo
        With ids from `next_id` on, not yet of any map, removed.
    """
    for row in rows:
        row.map_id, row.revision = record.id, record.revision
        record.next_id = max(record.next_id, row.id + 1)
        session.add(row)
    session.flush()
