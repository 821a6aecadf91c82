"""Recursive-descent parser of conditions, lists of columns, and sort orders.

::

    condition  = conjunction { OR conjunction }
    conjunction = part { AND part }
    part       = NOT part | "(" condition ")" | column test
    test       = ( "=" | "!=" | "<>" | "<" | "<=" | ">" | ">=" ) value
               | [ NOT ] BETWEEN value AND value | [ NOT ] IN "(" value { "," value } ")"
               | [ NOT ] LIKE 'pattern' | IS [ NOT ] NULL
    value      = number | 'text'
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import cast

from webapp.errors import UsageError
from webapp.missions.core.filters.nodes import (
    AllOf,
    Among,
    AnyOf,
    Between,
    Comparison,
    Condition,
    Kind,
    Like,
    Not,
    Operator,
    SortOrder,
    Unknown,
    Value,
)
from webapp.missions.core.filters.tokens import Token, mistake, tokens

MAX_DEPTH = 30
"""Depth of nested brackets and NOTs."""

MAX_VALUES = 200
"""Values in one `IN`."""

_SAME = {"==": "=", "<>": "!="}
_COMPARE = ("=", "==", "!=", "<>", "<", "<=", ">", ">=")
_WORDS = frozenset({"AND", "OR", "NOT", "IN", "BETWEEN", "LIKE", "IS", "NULL", "ASC", "DESC"})


def parse_condition(text: str, columns: Mapping[str, Kind], *, field: str = "where") -> Condition | None:
    """Parse a condition.

    Args:
        text: Blank means no condition.
        columns: Types of the available columns.
        field: Name of the text in messages.

    Raises:
        UsageError: Invalid syntax; `where` names the character, counted from 1.
    """
    reader = _Reader(text, columns, field)
    if reader.now.kind == "end":
        return None
    condition = reader.condition()
    reader.end()
    return condition


def parse_columns(text: str, columns: Mapping[str, Kind], *, field: str = "select") -> list[str]:
    """Parse a list of columns; `*` or an empty text means all of them. Raises UsageError."""
    reader = _Reader(text, columns, field)
    if reader.now.kind == "end" or (reader.now.is_sign("*") and reader.next()):
        chosen = list(columns)
    else:
        chosen = [reader.column()]
        while reader.took_sign(","):
            chosen.append(reader.column())
    reader.end()
    return list(dict.fromkeys(chosen))


def parse_order(text: str, columns: Mapping[str, Kind], *, field: str = "order") -> list[SortOrder]:
    """Parse a sort order: `confidence desc, class`. Raises UsageError."""
    reader = _Reader(text, columns, field)
    found: list[SortOrder] = []
    if reader.now.kind != "end":
        found.append(reader.order())
        while reader.took_sign(","):
            found.append(reader.order())
    reader.end()
    return found


class _Reader:
    """A parser over the tokens of a text."""

    def __init__(self, text: str, columns: Mapping[str, Kind], field: str) -> None:
        self._tokens = tokens(text, field)
        self._columns = columns
        self._field = field
        self._place = 0
        self._depth = 0

    @property
    def now(self) -> Token:
        return self._tokens[self._place]

    def next(self) -> Token:
        token = self.now
        self._place += token.kind != "end"
        return token

    def took_word(self, word: str) -> bool:
        return self.now.is_word(word) and bool(self.next())

    def took_sign(self, sign: str) -> bool:
        return self.now.is_sign(sign) and bool(self.next())

    def end(self) -> None:
        if self.now.kind != "end":
            raise self._wrong("AND, OR or the end" if self._field == "where" else "a comma or the end")

    def condition(self) -> Condition:
        parts = [self._conjunction()]
        while self.took_word("OR"):
            parts.append(self._conjunction())
        return parts[0] if len(parts) == 1 else AnyOf(tuple(parts))

    def _conjunction(self) -> Condition:
        parts = [self._part()]
        while self.took_word("AND"):
            parts.append(self._part())
        return parts[0] if len(parts) == 1 else AllOf(tuple(parts))

    def _part(self) -> Condition:
        opened = self.now
        if not (opened.is_word("NOT") or opened.is_sign("(")):
            return self._test()
        self.next()
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise mistake(f"more than {MAX_DEPTH} nested brackets", field=self._field, at=opened.at)
        inner = Not(self._part()) if opened.kind == "name" else self.condition()
        if opened.kind == "sign" and not self.took_sign(")"):
            raise self._wrong('AND, OR or ")"')
        self._depth -= 1
        return inner

    def column(self) -> str:
        token = self.now
        if token.kind != "name" or token.text.upper() in _WORDS:
            raise self._wrong("a column")
        name = token.text.lower()
        if name not in self._columns:
            raise mistake(
                f"there is no column {token.quoted()}",
                field=self._field,
                at=token.at,
                hint=f"the columns are {', '.join(self._columns)}",
            )
        self.next()
        return name

    def order(self) -> SortOrder:
        column = self.column()
        descending = self.took_word("DESC")
        if not descending:
            self.took_word("ASC")
        return SortOrder(column, descending)

    def _test(self) -> Condition:
        column = self.column()
        if self.now.is_sign(*_COMPARE):
            sign = self.next().text
            return Comparison(column, cast(Operator, _SAME.get(sign, sign)), self._value(column))
        if self.took_word("IS"):
            opposite = self.took_word("NOT")
            if not self.took_word("NULL"):
                raise self._wrong("NULL")
            return Not(Unknown(column)) if opposite else Unknown(column)
        opposite = self.took_word("NOT")
        found = self._range(column)
        return Not(found) if opposite else found

    def _range(self, column: str) -> Condition:
        if self.took_word("BETWEEN"):
            low = self._value(column)
            if not self.took_word("AND"):
                raise self._wrong("AND")
            return Between(column, low, self._value(column))
        if self.took_word("IN"):
            return Among(column, self._values(column))
        if self.now.is_word("LIKE"):
            if self._columns[column] != "text":
                raise mistake(
                    "LIKE needs a text column",
                    field=self._field,
                    at=self.now.at,
                    hint=f"compare {column} with a number",
                )
            self.next()
            return Like(column, str(self._value(column)))
        raise self._wrong("a comparison")

    def _values(self, column: str) -> tuple[Value, ...]:
        if not self.took_sign("("):
            raise self._wrong('"("')
        values = [self._value(column)]
        while self.took_sign(","):
            if len(values) == MAX_VALUES:
                raise mistake(f"more than {MAX_VALUES} values", field=self._field, at=self.now.at)
            values.append(self._value(column))
        if not self.took_sign(")"):
            raise self._wrong('a comma or ")"')
        return tuple(values)

    def _value(self, column: str) -> Value:
        token, kind = self.now, self._columns[column]
        if token.kind == "number" and kind != "text":
            value = float(token.text)
            if not math.isfinite(value):
                raise mistake(f"{token.quoted()} is too large", field=self._field, at=token.at)
            self.next()
            return value
        if token.kind == "text" and kind != "number":
            self.next()
            return token.text if kind == "text" else self._seconds(token)
        expected = {
            "number": "a number",
            "text": "text in single quotes",
            "time": "a time: '2026-05-01T10:00:00Z', or seconds since 1970",
        }
        raise self._wrong(expected[kind])

    def _seconds(self, token: Token) -> float:
        try:
            time = datetime.fromisoformat(token.text)
        except ValueError as error:
            raise mistake(
                f"{token.quoted()} is not a time",
                field=self._field,
                at=token.at,
                hint="write it as 2026-05-01T10:00:00Z",
            ) from error
        return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()

    def _wrong(self, expected: str) -> UsageError:
        return mistake(f"expected {expected}, not {self.now.quoted()}", field=self._field, at=self.now.at)
