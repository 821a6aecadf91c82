"""Photos of all maps by the day on which they were taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from webapp.store.maps import maps
from webapp.store.schema import Account, MapRecord, Photo

_day = func.substr(Photo.taken_at, 1, 10)


@dataclass(frozen=True, slots=True)
class DayOfMap:
    """The placed photos of a map of one day."""

    map: MapRecord
    count: int
    first: tuple[Photo, ...]  # The first of them


@dataclass(frozen=True, slots=True)
class Day:
    """What was photographed on a day."""

    date: str  # YYYY-MM-DD, by the cameras' clocks
    maps: tuple[DayOfMap, ...]


def days(session: Session, account: Account, *, before: str | None, most: int, photos: int) -> list[Day]:
    """List days with placed photos on maps that an account may see, the last day first.

    Args:
        before: Only days before this one; None for all.
        photos: Maximum number of photos of a map and day.
    """
    shown = _placed(account)
    known = select(_day).where(*shown, Photo.taken_at.is_not(None)).distinct()
    if before is not None:
        known = known.where(_day < before)
    dates = list(session.scalars(known.order_by(_day.desc()).limit(most)))
    same = (Photo.map_id, _day)
    number = func.row_number().over(partition_by=same, order_by=(Photo.taken_at, Photo.id)).label("number")
    count = func.count().over(partition_by=same).label("count")
    found = select(Photo.map_id, Photo.id, number, count).where(*shown, _day.in_(dates)).subquery()
    wanted = (
        select(Photo, MapRecord, found.c.count)
        .join(found, (found.c.map_id == Photo.map_id) & (found.c.id == Photo.id))
        .join(MapRecord, MapRecord.id == Photo.map_id)
        .where(found.c.number <= photos)
        .order_by(_day.desc(), MapRecord.name, MapRecord.id, Photo.taken_at, Photo.id)
    )
    rows = [(photo, record, in_all) for photo, record, in_all in session.execute(wanted)]
    grouped = groupby(rows, key=lambda row: (row[0].taken_at or "")[:10])
    return [Day(date, _by_map(list(of_day))) for date, of_day in grouped]


def count_without_time(session: Session, account: Account) -> int:
    """Count the placed photos, on maps that an account may see, that no day has."""
    found = select(func.count()).select_from(Photo).where(*_placed(account), Photo.taken_at.is_(None))
    return session.scalar(found) or 0


def _placed(account: Account) -> tuple[ColumnElement[bool], ...]:
    return (Photo.map_id.in_(maps.visible(account)), ~Photo.removed, Photo.x_px.is_not(None))


def _by_map(rows: Sequence[tuple[Photo, MapRecord, int]]) -> tuple[DayOfMap, ...]:
    return tuple(
        DayOfMap(of_map[0][1], of_map[0][2], tuple(photo for photo, _, _ in of_map))
        for of_map in (list(group) for _, group in groupby(rows, key=lambda row: row[1].id))
    )
