"""Decimal commas and thousands points of a table, decided by whole columns.

`1.234` is 1.234 or 1234: other cells of its column show which, such as `1.200,5` or `12,5`, or else the other
columns do. Latitudes and longitudes have no thousands: each mark in them is a decimal one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

_BLANK = "'’ \u00a0\u2009\u202f"
_NUMBER = re.compile(rf"[+-]?(\d[\d.,{_BLANK}]*)[^\d]*")
_GROUPS = re.compile(r"[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*")
_BLANKS = re.compile(rf"(?<=\d)[{_BLANK}](?=\d{{3}}(?:\D|$))")
_DECIMAL = re.compile(r"\d([.,])\d")
_OTHER = {".": ",", ",": "."}


@dataclass(slots=True)
class _Seen:
    """What the cells of a column show: a cell for each mark."""

    decimal: dict[str, str] = field(default_factory=dict)
    thousands: dict[str, str] = field(default_factory=dict)
    unsure: dict[str, str] = field(default_factory=dict)

    def add(self, text: str, *, is_angle: bool) -> None:
        if is_angle:
            for mark in _DECIMAL.findall(text):
                self.decimal.setdefault(mark, text)
            return
        found = _NUMBER.fullmatch(text)
        if found is None:
            return
        digits = _BLANKS.sub("", found[1]).rstrip(f".,{_BLANK}")
        marks = [one for one in digits if one in _OTHER]
        if len(set(marks)) == 2 and marks.count(marks[-1]) == 1:
            self.decimal.setdefault(marks[-1], text)
            self.thousands.setdefault(marks[0], text)
        elif len(marks) == 1 and not _GROUPS.fullmatch(digits):
            self.decimal.setdefault(marks[0], text)
        elif len(marks) == 1:
            self.unsure.setdefault(marks[0], text)
        elif marks and _GROUPS.fullmatch(digits):
            self.thousands.setdefault(marks[0], text)

    @property
    def sure(self) -> set[str]:
        """The decimal marks that the column shows: none, one, or both if it contradicts itself."""
        return {*self.decimal, *(_OTHER[mark] for mark in self.thousands)}


@dataclass(frozen=True, slots=True)
class NumberMarks:
    """The decimal mark of each column, by field; the other one separates thousands."""

    decimal: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # What was decided, for people

    def plain(self, text: str, name: str) -> str:
        """Write the numbers of a cell with decimal points and without thousands."""
        mark = self.decimal.get(name)
        if mark is None:
            return text.replace(",", ".") if "," in text and "." not in text else text
        if not text.isascii() or " " in text or "'" in text:
            text = _BLANKS.sub("", text)
        return text.replace(_OTHER[mark], "").replace(mark, ".")


def find_marks(rows: Iterable[Mapping[str, str]], *, angles: Sequence[str], usual: str) -> NumberMarks:
    """Decide on the marks of all columns.

    Args:
        rows: The cells of each row that hold numbers, by field.
        angles: Fields of latitudes and longitudes.
        usual: What a comma is where no cell shows it: "," for decimal, "." for one that separates thousands.
    """
    seen: dict[str, _Seen] = {}
    for row in rows:
        for name, text in row.items():
            if "." in text or "," in text:
                seen.setdefault(name, _Seen()).add(text, is_angle=name in angles)
    sure = {mark for one in seen.values() for mark in one.sure}
    decimal: dict[str, str] = {}
    notes: list[str] = []
    for name, one in seen.items():
        if len(one.sure) == 2:
            notes.append(f"{name} has decimal points and decimal commas: both are taken as decimal")
            continue
        if one.sure:
            (decimal[name],) = one.sure
        elif one.unsure:
            decimal[name] = next(iter(sure)) if len(sure) == 1 else "," if "," in one.unsure else "."
            if not sure and decimal[name] == ",":
                decimal[name] = usual
    return NumberMarks(decimal, (*notes, *_notes(seen, decimal)))


def _notes(seen: Mapping[str, _Seen], decimal: Mapping[str, str]) -> list[str]:
    known = NumberMarks(decimal)
    notes = []
    for name, mark in decimal.items():
        grouped = seen[name].thousands.get(_OTHER[mark]) or seen[name].unsure.get(_OTHER[mark])
        if grouped:
            kind = "points" if mark == "," else "commas"
            value = known.plain(grouped, name)
            notes.append(f"{kind} in {name} separate thousands: {grouped} was read as {value}")
    commas = ((name, {**seen[name].unsure, **seen[name].decimal}.get(",")) for name in decimal)
    shown = next(((name, text) for name, text in commas if text and decimal[name] == ","), None)
    if shown is not None:
        notes.append(f"commas are decimal: {shown[1]} was read as {known.plain(shown[1], shown[0])}")
    return notes
