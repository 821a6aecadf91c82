"""Lists that are given in parts, the last changed first."""

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
    """A place in a list: just after a record as it was then, wherever that record is now."""

    changed_at: datetime
    id: int

    def text(self) -> str:
        """Return it as clients get it: microseconds since 1970, and the id; `read_cursor` reads it."""
        return f"{(self.changed_at - _EPOCH) // timedelta(microseconds=1)}.{self.id}"

    def follow(self, changed_at: Moments, id: Ids) -> ColumnElement[bool]:
        """Select the records after it in the order of `last_changed_first`."""
        same = and_(changed_at == self.changed_at, id < self.id)
        return or_(changed_at < self.changed_at, same)


@dataclass(frozen=True, slots=True)
class ListPart:
    """Which records are listed.

    Attributes
    ----------
    binned : bool
        Those in the bin instead of those in use.
    search : str
        Only those with this text in their name; case and accents do not matter.
    after : ListCursor or None
        Only those after it.
    limit : int or None
        Maximum number; None for all.
    """

    binned: bool = False
    search: str = ""
    after: ListCursor | None = None
    limit: int | None = None


def is_cursor(text: str) -> bool:
    """Return whether a text has the form of a cursor, with an id that a record can have."""
    return _FORM.fullmatch(text) is not None and int(text.partition(".")[2]) <= MAX_NUMBER


def read_cursor(text: str) -> ListCursor:
    """Read a cursor, where `is_cursor` says that it is one."""
    changed, id = map(int, text.split("."))
    return ListCursor(_EPOCH + timedelta(microseconds=changed), id)


def last_changed_first(changed_at: Moments, id: Ids) -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    """Return the order of lists."""
    return changed_at.desc(), id.desc()
