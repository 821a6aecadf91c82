"""Filter conditions on the rows of a table, as people write them: `class = 'car' AND confidence > 0.5`.

A recursive-descent parser of conditions, lists of columns and sort orders: the text becomes a syntax tree,
and is never inserted into another language such as SQL. Each error has the position of its character.

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
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, cast

from webapp.errors import UsageError

MAX_DEPTH = 30
"""Depth of nested brackets and NOTs."""

MAX_VALUES = 200
"""Values in one `IN`."""

_SAME = {"==": "=", "<>": "!="}
_COMPARE = ("=", "==", "!=", "<>", "<", "<=", ">", ">=")
_WORDS = frozenset({"AND", "OR", "NOT", "IN", "BETWEEN", "LIKE", "IS", "NULL", "ASC", "DESC"})

MAX_CHARACTERS = 2000

_TokenKind = Literal["name", "number", "text", "sign", "end"]

_TOKEN = re.compile(
    r"""
    (?P<space>\s+)
    | (?P<name>[A-Za-z_][A-Za-z_0-9]*)
    | (?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | '(?P<text>(?:[^']|'')*)'
    | (?P<sign><=|>=|<>|!=|==|[=<>(),*])
    """,
    re.VERBOSE | re.ASCII,
)
_UNFIT = re.compile("[\x00\ud800-\udfff]")
"""Characters that databases cannot store as text."""

Kind = Literal["number", "text", "time"]
"""Type of a column; a time is written as ISO 8601 or in seconds since 1970, and is compared as seconds."""

_Operator = Literal["=", "!=", "<", "<=", ">", ">="]
_Value = float | str


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
        self._tokens = _tokens(text, field)
        self._columns = columns
        self._field = field
        self._place = 0
        self._depth = 0

    @property
    def now(self) -> _Token:
        return self._tokens[self._place]

    def next(self) -> _Token:
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
            raise _mistake(f"more than {MAX_DEPTH} nested brackets", field=self._field, at=opened.at)
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
            raise _mistake(
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
            return Comparison(column, cast(_Operator, _SAME.get(sign, sign)), self._value(column))
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
                raise _mistake(
                    "LIKE needs a text column",
                    field=self._field,
                    at=self.now.at,
                    hint=f"compare {column} with a number",
                )
            self.next()
            return Like(column, str(self._value(column)))
        raise self._wrong("a comparison")

    def _values(self, column: str) -> tuple[_Value, ...]:
        if not self.took_sign("("):
            raise self._wrong('"("')
        values = [self._value(column)]
        while self.took_sign(","):
            if len(values) == MAX_VALUES:
                raise _mistake(f"more than {MAX_VALUES} values", field=self._field, at=self.now.at)
            values.append(self._value(column))
        if not self.took_sign(")"):
            raise self._wrong('a comma or ")"')
        return tuple(values)

    def _value(self, column: str) -> _Value:
        token, kind = self.now, self._columns[column]
        if token.kind == "number" and kind != "text":
            value = float(token.text)
            if not math.isfinite(value):
                raise _mistake(f"{token.quoted()} is too large", field=self._field, at=token.at)
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

    def _seconds(self, token: _Token) -> float:
        try:
            time = datetime.fromisoformat(token.text)
        except ValueError as error:
            raise _mistake(
                f"{token.quoted()} is not a time",
                field=self._field,
                at=token.at,
                hint="write it as 2026-05-01T10:00:00Z",
            ) from error
        return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()

    def _wrong(self, expected: str) -> UsageError:
        return _mistake(f"expected {expected}, not {self.now.quoted()}", field=self._field, at=self.now.at)


@dataclass(frozen=True, slots=True)
class _Token:
    kind: _TokenKind
    text: str  # As written; for quoted text, without the quotes
    at: int  # Position of its first character, from 1

    def is_word(self, *words: str) -> bool:
        """Return whether it is one of these keywords, given in upper case."""
        return self.kind == "name" and self.text.upper() in words

    def is_sign(self, *signs: str) -> bool:
        """Return whether it is one of these operators or punctuation marks."""
        return self.kind == "sign" and self.text in signs

    def quoted(self) -> str:
        if self.kind == "end":
            return "the end"
        return f"'{self.text[:40]}'" if self.kind == "text" else f'"{self.text[:40]}"'


def _tokens(text: str, field: str) -> list[_Token]:
    """Split a text into tokens.

    Args:
        text: At most `MAX_CHARACTERS` long.
        field: Name of the text in messages: `where`.

    Returns:
        The last one has the kind "end".

    Raises:
        UsageError: The text is too long or has an invalid character; `where` names its position.
    """
    if len(text) > MAX_CHARACTERS:
        raise _mistake(f"more than {MAX_CHARACTERS} characters", field=field, at=MAX_CHARACTERS + 1)
    unfit = _UNFIT.search(text)
    if unfit:
        raise _mistake("an invalid character", field=field, at=unfit.start() + 1)
    found: list[_Token] = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _strange(text, at, field=field)
        kind = cast("_TokenKind | Literal['space']", match.lastgroup)
        if kind != "space":
            word = match[kind]
            found.append(_Token(kind, word.replace("''", "'") if kind == "text" else word, at + 1))
        at = match.end()
    return [*found, _Token("end", "", len(text) + 1)]


def _mistake(message: str, *, field: str, at: int, hint: str | None = None) -> UsageError:
    """Return an error at the character `at`, counted from 1."""
    return UsageError(message, where=f"{field}, character {at}", hint=hint)


def _strange(text: str, at: int, *, field: str) -> UsageError:
    if text[at] == "'":
        return _mistake("unterminated text", field=field, at=at + 1, hint="close it with another '")
    hint = "put text in single quotes: 'car'" if text[at] in '"`‘’“”' else None
    return _mistake(f'unexpected character "{text[at]}"', field=field, at=at + 1, hint=hint)


@dataclass(frozen=True, slots=True)
class Comparison:
    """`column < value`."""

    column: str
    operator: _Operator
    value: _Value


@dataclass(frozen=True, slots=True)
class Between:
    """`column BETWEEN low AND high`, both included."""

    column: str
    low: _Value
    high: _Value


@dataclass(frozen=True, slots=True)
class Among:
    """`column IN (value, ...)`."""

    column: str
    values: tuple[_Value, ...]


@dataclass(frozen=True, slots=True)
class Like:
    """`column LIKE pattern`: `%` matches any text, `_` any character; case-insensitive."""

    column: str
    pattern: str


@dataclass(frozen=True, slots=True)
class Unknown:
    """`column IS NULL`."""

    column: str


@dataclass(frozen=True, slots=True)
class Not:
    """Negation of a condition."""

    of: Condition


@dataclass(frozen=True, slots=True)
class AllOf:
    """`a AND b AND ...`."""

    of: tuple[Condition, ...]


@dataclass(frozen=True, slots=True)
class AnyOf:
    """`a OR b OR ...`."""

    of: tuple[Condition, ...]


Condition = Comparison | Between | Among | Like | Unknown | Not | AllOf | AnyOf


@dataclass(frozen=True, slots=True)
class SortOrder:
    """One column to sort by."""

    column: str
    descending: bool
