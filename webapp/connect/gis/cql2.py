"""Filters of features in CQL2 text (OGC 21-065r2), class *Basic CQL2*: a parser, and three-valued evaluation.

::

    expression = term { OR term }
    term       = factor { AND factor }
    factor     = { NOT } ( "(" expression ")" | TRUE | FALSE | property test | literal sign property )
    test       = sign literal | IS [ NOT ] NULL
    sign       = "=" | "<>" | "<" | "<=" | ">" | ">="
    literal    = number | 'text' | TRUE | FALSE | DATE('2026-05-01') | TIMESTAMP('2026-05-01T10:00:00Z')
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from operator import eq, ge, gt, le, lt, ne
from typing import Any, Literal, NamedTuple

from webapp.errors import UsageError
from webapp.files.exchange.times import unix_time

MAX_CHARACTERS = 2000
MAX_DEPTH = 30
"""Depth of nested brackets and NOTs."""

Kind = Literal["number", "text", "time", "boolean"]
Values = Mapping[str, Any]
Filter = Callable[[Values], bool | None]
"""Returns whether a feature is wanted, by its properties; None if that is unknown, which counts as no."""

_SIGNS: Mapping[str, Callable[[Any, Any], bool]] = {"=": eq, "<>": ne, "<": lt, "<=": le, ">": gt, ">=": ge}
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_WORDS = ("AND", "OR", "NOT", "IS", "NULL", "TRUE", "FALSE", "DATE", "TIMESTAMP")
_DAY_S = 86_400
_DATE = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)
_TOKEN = re.compile(
    r"""
    (?P<space>\s+)
    | (?P<name>[A-Za-z_:][A-Za-z_:.0-9]*|"[^"]+")
    | (?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | '(?P<text>(?:[^'\\]|''|\\.)*)'
    | (?P<sign><=|>=|<>|[=<>()])
    """,
    re.VERBOSE | re.ASCII | re.DOTALL,
)
_EXPECTED: Mapping[Kind, str] = {
    "number": "a number",
    "text": "text in single quotes",
    "time": "TIMESTAMP('2026-05-01T10:00:00Z') or DATE('2026-05-01')",
    "boolean": "TRUE or FALSE",
}


class _Token(NamedTuple):
    kind: str  # word, name, number, text, sign or end; a word is in capital letters
    text: str
    at: int  # Position of its first character, from 1


class _Operand(NamedTuple):
    """A literal: its type, and a number, text, boolean, Unix time or, of a date, number of the day."""

    kind: Kind
    value: float | str | bool
    is_date: bool = False


def parse_filter(text: str, queryables: Mapping[str, Kind]) -> Filter:
    """Parse a filter.

    Args:
        queryables: Types of the properties that it may name.

    Raises:
        UsageError: Invalid syntax, or another property or type; `where` names the character, counted from 1.
    """
    reader = _Reader(_tokens(text), queryables)
    found = reader.expression()
    if reader.now.kind != "end":
        raise reader.unexpected("AND, OR or the end")
    return found


class _Reader:
    def __init__(self, tokens: list[_Token], queryables: Mapping[str, Kind]) -> None:
        self._tokens, self._queryables = tokens, queryables
        self._place = self._depth = 0

    @property
    def now(self) -> _Token:
        return self._tokens[self._place]

    def _next(self) -> _Token:
        token = self.now
        self._place += token.kind != "end"
        return token

    def _took(self, kind: str, *texts: str) -> bool:
        found = self.now.kind == kind and self.now.text in texts
        self._place += found
        return found

    def unexpected(self, expected: str) -> UsageError:
        found = "the end" if self.now.kind == "end" else f'"{self.now.text[:40]}"'
        return _mistake(f"expected {expected}, not {found}", self.now.at)

    def expression(self) -> Filter:
        parts = [self._term()]
        while self._took("word", "OR"):
            parts.append(self._term())
        return parts[0] if len(parts) == 1 else lambda values: _any(part(values) for part in parts)

    def _term(self) -> Filter:
        parts = [self._factor()]
        while self._took("word", "AND"):
            parts.append(self._factor())
        return (
            parts[0]
            if len(parts) == 1
            else lambda values: _negated(_any(_negated(part(values)) for part in parts))
        )

    def _factor(self) -> Filter:
        if self._depth == MAX_DEPTH:
            raise _mistake(f"more than {MAX_DEPTH} nested brackets and NOTs", self.now.at)
        self._depth += 1
        try:
            if self._took("word", "NOT"):
                inner = self._factor()
                return lambda values: _negated(inner(values))
            if self._took("sign", "("):
                inner = self.expression()
                if not self._took("sign", ")"):
                    raise self.unexpected('AND, OR or ")"')
                return inner
            return self._predicate()
        finally:
            self._depth -= 1

    def _predicate(self) -> Filter:
        if self.now.kind == "name":
            name = self._property()
            if self._took("word", "IS"):
                return self._null_test(name)
            sign = self._sign()
            at = self.now.at
            return self._comparison(name, sign, at=at, given=self._literal(self._queryables[name]))
        at, given = self.now.at, self._literal(None)
        if given.kind == "boolean" and self.now.text not in _SIGNS:
            return lambda _: bool(given.value)
        sign = self._sign()
        if self.now.kind != "name":
            raise self.unexpected("a property")
        return self._comparison(self._property(), _MIRRORED.get(sign, sign), at=at, given=given)

    def _property(self) -> str:
        token = self._next()
        if token.text not in self._queryables:
            hint = f"use {', '.join(self._queryables)}"
            raise _mistake(f'"{token.text[:40]}" is not a property here', token.at, hint=hint)
        return token.text

    def _sign(self) -> str:
        if self.now.kind != "sign" or self.now.text not in _SIGNS:
            raise self.unexpected(f"{', '.join(_SIGNS)} or IS NULL")
        return self._next().text

    def _null_test(self, name: str) -> Filter:
        opposite = self._took("word", "NOT")
        if not self._took("word", "NULL"):
            raise self.unexpected("NULL")
        return lambda values: (values.get(name) is None) != opposite

    def _comparison(self, name: str, sign: str, *, at: int, given: _Operand) -> Filter:
        kind, compare = self._queryables[name], _SIGNS[sign]
        if given.kind != kind:
            raise _mistake(f"{name} is compared with {_EXPECTED[kind]}", at)

        def holds(values: Values) -> bool | None:
            value = values.get(name)
            if kind == "time" and value is not None:
                value = unix_time(str(value))
                value = None if math.isnan(value) else value // _DAY_S if given.is_date else value
            return None if value is None else compare(value, given.value)

        return holds

    def _literal(self, kind: Kind | None) -> _Operand:
        token = self.now
        if token.kind == "number" and math.isfinite(float(token.text)):
            self._next()
            return _Operand("number", float(token.text))
        if token.kind == "text":
            self._next()
            return _Operand("text", token.text)
        if self._took("word", "TRUE", "FALSE"):
            return _Operand("boolean", token.text == "TRUE")
        if self._took("word", "DATE", "TIMESTAMP"):
            return self._time(is_date=token.text == "DATE")
        raise self.unexpected("a property or a value" if kind is None else _EXPECTED[kind])

    def _time(self, *, is_date: bool) -> _Operand:
        if not self._took("sign", "("):
            raise self.unexpected('"("')
        token = self._next()
        time_s = unix_time(token.text) if token.kind == "text" else math.nan
        if math.isnan(time_s) or is_date != bool(_DATE.fullmatch(token.text)):
            wanted = "2026-05-01" if is_date else "2026-05-01T10:00:00Z"
            raise _mistake(f"this is not a {'date' if is_date else 'time'}", token.at, hint=f"use '{wanted}'")
        if not self._took("sign", ")"):
            raise self.unexpected('")"')
        return _Operand("time", time_s // _DAY_S if is_date else time_s, is_date)


def _any(parts: Any) -> bool | None:
    """Return whether a part holds; None if none does, but one may."""
    found: bool | None = False
    for part in parts:
        if part:
            return True
        found = None if part is None else found
    return found


def _negated(found: bool | None) -> bool | None:
    return None if found is None else not found


def _tokens(text: str) -> list[_Token]:
    if len(text) > MAX_CHARACTERS:
        raise _mistake(f"more than {MAX_CHARACTERS} characters", MAX_CHARACTERS + 1)
    found: list[_Token] = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            quote = text[at] == "'"
            message = "unterminated text" if quote else f'unexpected character "{text[at]}"'
            raise _mistake(message, at + 1, hint="close it with another '" if quote else None)
        kind = str(match.lastgroup)
        word = match[kind]
        if kind == "text":
            word = re.sub(r"''|\\(.)", lambda m: m[1] or "'", word, flags=re.DOTALL)
        elif kind == "name" and word.startswith('"'):
            word = word[1:-1]
        elif kind == "name" and word.upper() in _WORDS:
            kind, word = "word", word.upper()
        if kind != "space":
            found.append(_Token(kind, word, at + 1))
        at = match.end()
    return [*found, _Token("end", "", len(text) + 1)]


def _mistake(message: str, at: int, *, hint: str | None = None) -> UsageError:
    return UsageError(message, where=f"filter, character {at}", hint=hint)
