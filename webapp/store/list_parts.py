"""Lists that are returned in parts, the last changed records first."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, and_, or_
from sqlalchemy.orm import InstrumentedAttribute

from webapp.core.mapmodel.checks import MAX_NUMBER

_FORM = re.compile(r"[0-9]{1,17}\.[0-9]{1,10}")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Moments = InstrumentedAttribute[datetime]
Ids = InstrumentedAttribute[int]


class ListCursor(NamedTuple):
    """A position in a list: just after a record's position at the time, wherever the record is now."""

    changed_at: datetime
    id: int

    def text(self) -> str:
        """Return its form for clients: microseconds since 1970, and the id; `read_cursor` reads it."""
        return f"{(self.changed_at - _EPOCH) // timedelta(microseconds=1)}.{self.id}"

    def follow(self, changed_at: Moments, id: Ids) -> ColumnElement[bool]:
        """Return the condition for the records after it in the order of `last_changed_first`."""
        same = and_(changed_at == self.changed_at, id < self.id)
        return or_(changed_at < self.changed_at, same)


@dataclass(frozen=True, slots=True)
class ListPart:
    binned: bool = False  # Whether to list the records in the bin instead of those in use
    search: str = ""  # Only records with this text in their name, ignoring case and accents
    after: ListCursor | None = None  # Only records after it
    limit: int | None = None  # Maximum number; None for all


def is_cursor(text: str) -> bool:
    """Return whether a text has the form of a cursor, with a possible id."""
    return _FORM.fullmatch(text) is not None and int(text.partition(".")[2]) <= MAX_NUMBER


def read_cursor(text: str) -> ListCursor:
    """Parse a cursor; `is_cursor` must be true."""
    changed, id = map(int, text.split("."))
    return ListCursor(_EPOCH + timedelta(microseconds=changed), id)


def last_changed_first(changed_at: Moments, id: Ids) -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    return changed_at.desc(), id.desc()
