"""Schema fields that are stricter than marshmallow's, and the pagination of lists."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import apiflask.fields
from apiflask import Schema
from apiflask.fields import Integer, String
from apiflask.validators import Length, Range

from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.store.list_parts import is_cursor, read_cursor

LATER = Length(max=1000)
"""Of names and the like, whose own limit is checked where they are stored."""

_TEXTS = {"true": True, "1": True, "false": False, "0": False}


class Boolean(apiflask.fields.Boolean):
    """Accepts only true and false in JSON, and `true`, `1`, `false` and `0` in forms and query strings."""

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> bool:
        if isinstance(value, bool):
            return value
        is_json = isinstance(data, dict)  # forms and query strings are MultiDict proxies
        if not is_json and isinstance(value, str) and value.lower() in _TEXTS:
            return _TEXTS[value.lower()]
        raise self.make_error("invalid", input=value)


class RecordNumber(apiflask.fields.Integer):
    """The id of a record or a revision number, limited to the range of a column of every database.

    Args:
        least: Minimum; -1 if that means "before the first one".
    """

    def __init__(self, *, least: int = 0, **options: Any) -> None:
        super().__init__(validate=Range(least, MAX_NUMBER), **options)


class CheckedText(apiflask.fields.String):
    """A text that has to pass a check.

    Args:
        check: Returns whether a text is valid.
        refusal: Error message for invalid texts.
    """

    def __init__(self, *, check: Callable[[str], bool], refusal: str, **options: Any) -> None:
        super().__init__(error_messages={"refused": refusal}, **options)
        self._check = check

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> str:
        text = str(super()._deserialize(value, attr, data, **options))
        if not self._check(text):
            raise self.make_error("refused")
        return text


class BoundedList(apiflask.fields.List[Any]):
    """A list with a maximum length, which is checked before its items are converted."""

    def __init__(
        self, inner: apiflask.fields.Field[Any], *, most: int, least: int | None = None, **options: Any
    ):
        super().__init__(inner, validate=Length(least, most), **options)
        self.most = most

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> list[Any]:
        if isinstance(value, list):
            self._validate(value)
        return super()._deserialize(value, attr, data, **options)


class BoundedDict(apiflask.fields.Dict):
    """An object with any names, and a maximum number of them, which is checked before they are converted."""

    def __init__(
        self,
        *,
        keys: apiflask.fields.Field[Any],
        values: apiflask.fields.Field[Any],
        most: int,
        **options: Any,
    ) -> None:
        super().__init__(keys=keys, values=values, validate=Length(max=most), **options)
        self.key, self.value, self.most = keys, values, most

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> Any:
        if isinstance(value, dict):
            self._validate(value)
        return super()._deserialize(value, attr, data, **options)  # type: ignore[no-untyped-call]


class JsonValue(apiflask.fields.Raw):
    """JSON that is checked where it is stored.

    Args:
        bytes, values: Maximum size, and number of values in it.
    """

    def __init__(self, *, bytes: int, values: int, **options: Any) -> None:
        super().__init__(**options)
        self.bytes, self.values = bytes, values


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
