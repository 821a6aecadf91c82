"""Nodes of the syntax tree of a condition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["number", "text", "time"]
"""Type of a column; a time is written as ISO 8601 or in seconds since 1970, and is compared as seconds."""

Operator = Literal["=", "!=", "<", "<=", ">", ">="]
Value = float | str


@dataclass(frozen=True, slots=True)
class Comparison:
    """`column < value`."""

    column: str
    operator: Operator
    value: Value


@dataclass(frozen=True, slots=True)
class Between:
    """`column BETWEEN low AND high`, both included."""

    column: str
    low: Value
    high: Value


@dataclass(frozen=True, slots=True)
class Among:
    """`column IN (value, ...)`."""

    column: str
    values: tuple[Value, ...]


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
