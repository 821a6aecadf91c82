"""Pagination of lists."""

from __future__ import annotations

from typing import Any, TypeVar

from apiflask import Schema
from apiflask.fields import Integer, String
from apiflask.validators import Length, Range

from webapp.store.list_parts import is_cursor, read_cursor
from webapp.web.fields import LATER, Boolean, CheckedText

MOST_SEARCHED = 120
_MOST = 10_000

Item = TypeVar("Item")


class ListPartQuery(Schema):
    """The requested part of a list."""

    bin = Boolean(load_default=False, metadata={"description": "What is in the bin instead."})
    search = String(
        load_default="",
        validate=Length(max=MOST_SEARCHED),
        metadata={"description": "Only those with it in their name, or a mission's map, in any case."},
    )
    after = CheckedText(
        load_default=None,
        check=is_cursor,
        validate=LATER,
        refusal="This is no `next` of an earlier answer.",
        metadata={"description": "`next` of an earlier answer: those that follow."},
    )
    limit = Integer(
        load_default=None,
        validate=Range(1, _MOST),
        metadata={"description": "Maximum number; by default all."},
    )


def wanted_part(query: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters of the database query; its limit is one higher, to see whether others follow."""
    after, limit = query["after"], query["limit"]
    return {
        "binned": query["bin"],
        "search": query["search"],
        "after": None if after is None else read_cursor(after),
        "limit": None if limit is None else limit + 1,
    }


def split(found: list[Item], limit: int | None) -> tuple[list[Item], Item | None]:
    """Return the items to show, and the last of them if others follow."""
    shown = found[:limit]
    return shown, shown[-1] if len(found) > len(shown) else None
