"""Parses a `.cfg` line by line and collects all faults.

The strict reader (`cfg`) raises the first fault, the linter (`tasks.maps.check_map`) lists all: both share
this grammar.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from typing import TypeVar

from webapp.core.geo.types import round_half_up
from webapp.core.mapmodel.checks import MAX_NUMBER, ImageLine, PhotoLine
from webapp.core.mapmodel.findings import Code, Finding, quoted
from webapp.core.mapmodel.paths import name_problem

_INTEGER = re.compile(r"-?[0-9]+")
_FRACTION = re.compile(r"(-?[0-9]{1,10})[.,]([0-9]{0,10})")


class CfgFieldError(Exception):
    """A field breaks the format.

    Args:
        better: The corrected text, if it is clear.
    """

    def __init__(self, code: Code, message: str, *, better: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.better = better


def parse_name(text: str) -> str:
    """Read the path of a photo or image."""
    problem = name_problem(text)
    if problem:
        raise CfgFieldError(problem.code, problem.message, better=problem.better)
    return text


def parse_id(text: str) -> int:
    """Read an id: digits only, at most 2147483647. Raises CfgFieldError."""
    if not _INTEGER.fullmatch(text):
        better = text[1:] if _INTEGER.fullmatch(text[1:]) and text[0] == "+" else None
        raise CfgFieldError(
            Code.NON_NUMERIC_ID, f"the id {quoted(text)} is not a whole number", better=better
        )
    return _limited(text, "the id", smallest=0)


def parse_size(text: str, what: str) -> int:
    """Read the image's width or height in pixels, from 1. Raises CfgFieldError."""
    return _limited(_whole(text, what), what, smallest=1)


def parse_coordinate(text: str, what: str) -> int:
    """Read x or y in whole pixels; `check_lines` checks whether it is inside the image.

    Raises CfgFieldError.
    """
    return _limited(_whole(text, what), what, smallest=-MAX_NUMBER)


def _whole(text: str, what: str) -> str:
    if _INTEGER.fullmatch(text):
        return text
    if not text:
        raise CfgFieldError(Code.NOT_AN_INTEGER, f"{what} is empty: a whole number of pixels is needed")
    fraction = _FRACTION.fullmatch(text)
    better = str(round_half_up(float(Decimal(f"{fraction[1]}.{fraction[2]}0")))) if fraction else None
    if fraction and "," in text:
        message = f"{what} = {quoted(text)} has a decimal comma: pixels are whole numbers"
        raise CfgFieldError(Code.DECIMAL_COMMA, message, better=better)
    if text[0] == "+" and _INTEGER.fullmatch(text[1:]):
        better = text[1:]
    message = f"{what} = {quoted(text)} is not a whole number in plain digits"
    raise CfgFieldError(Code.NOT_AN_INTEGER, message, better=better)


def _limited(text: str, what: str, *, smallest: int) -> int:
    """Convert digits to a number within limits; too many digits are refused before the conversion."""
    sign, digits = ("-", text[1:]) if text.startswith("-") else ("", text)
    digits = digits.lstrip("0") or "0"
    value = int(sign + digits) if len(digits) <= 10 else None
    if value is None or not smallest <= value <= MAX_NUMBER:
        message = f"{what} = {quoted(text)} is not between {smallest} and {MAX_NUMBER}"
        raise CfgFieldError(Code.NUMBER_OUT_OF_RANGE, message)
    return value


T = TypeVar("T")

_WIDEST = 4
"""Columns into which a line is split; all others stay one cell, even if there are a million."""

_LONGEST_LINE = 10_000
"""Characters; file systems allow names of at most 1000."""

BOM = b"\xef\xbb\xbf"
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")
_IMAGE_STARTS = ("\udcff\udcd8\udcff", "\udc89PNG")
"""First bytes of JPEG and PNG files, decoded with `surrogateescape`."""

_ESCAPED_BYTE = re.compile(r"[\udc80-\udcff]")
_TWO_NUMBERS = re.compile(r"[0-9]+ *, *[0-9]+")
_CONTROL_NAMES = {
    "\0": ("a NUL byte", "delete it, or save the file as plain UTF-8 text"),
    "\r": ("a carriage return inside the line", "end lines with LF or CRLF"),
}
_LEADING_ID = re.compile(rb"^ *([0-9]{1,9}) *;", re.MULTILINE)


@dataclass(slots=True)
class Scan:
    """A parsed `.cfg`; BOM, lines with their ends, and tail add up to the file."""

    bom: bool = False  # Whether it begins with a byte order mark
    # `lines`, `ends`: Text of each line up to the last non-blank one, and its end: LF, CRLF or nothing.
    lines: list[str] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)
    tail: str = ""  # Trailing blank lines
    image: ImageLine | None = None
    photos: list[PhotoLine] = field(default_factory=list)
    # Lines that could be read neither as a photo's nor as the image's.
    unread: list[str] = field(default_factory=list)
    faults: list[Finding] = field(default_factory=list)  # In the order of the file


@dataclass(frozen=True, slots=True)
class _Row:
    """One line and its cells, without surrounding spaces; a fifth cell holds all that follows the fourth."""

    number: int
    text: str
    cells: tuple[str, ...]
    columns: tuple[int, ...]

    def finding(self, code: Code, column: int, *, message: str, fix: str) -> Finding:
        return Finding(code, self.number, column, message, fix)

    def corrected(self, cell: int, text: str) -> str:
        """Return the line with another text in one cell."""
        return ";".join([*self.cells[:cell], text, *self.cells[cell + 1 :]])


def scan(data: bytes) -> Scan:
    """Parse a `.cfg`; faults are collected, never raised."""
    result = Scan(bom=data.startswith(BOM))
    starts = _split(data, result)
    if not result.lines:
        fix = "the first line is satellite.png;WIDTH;HEIGHT, then a line id;photo.jpg;x;y for each photo"
        result.faults.append(Finding(Code.EMPTY_FILE, 1, 1, "the file is empty", fix))
    free_ids = itertools.count(max((int(found) for found in _LEADING_ID.findall(data)), default=-1) + 1)
    for number, (text, start) in enumerate(zip(result.lines, starts, strict=True), start=1):
        row = _row(number, text)
        unreadable = _character_fault(row, start)
        fault = unreadable or _count_fault(row)
        if fault:
            result.faults.append(fault)
        if unreadable or (fault and not _is_photo(row)):
            result.unread.append(text)
        elif _is_photo(row):
            result.photos.append(_photo_line(row, free_ids, result.faults))
        else:
            result.image = _image_line(row, result.faults)
    return result


def _split(data: bytes, result: Scan) -> list[int]:
    """Fill in lines, ends and tail; return the offset of each line's first byte."""
    offset = len(BOM) if result.bom else 0
    starts, pieces = [], data[offset:].split(b"\n")
    for i, piece in enumerate(pieces):
        last = i == len(pieces) - 1
        carriage = piece.endswith(b"\r") and not last
        if piece or not last:
            line = piece[:-1] if carriage else piece
            # bytes that are not UTF-8 become lone surrogates, which valid text never has
            result.lines.append(line.decode("utf-8", "surrogateescape"))
            result.ends.append("" if last else "\r\n" if carriage else "\n")
            starts.append(offset)
        offset += len(piece) + 1
    count = len(result.lines)
    while count and not result.lines[count - 1].strip(" "):
        count -= 1
    result.tail = "".join(map(str.__add__, result.lines[count:], result.ends[count:]))
    del result.lines[count:], result.ends[count:], starts[count:]
    return starts


def _row(number: int, text: str) -> _Row:
    cells, columns, at = [], [], 1
    for cell in text.split(";", _WIDEST):
        cells.append(cell.strip(" "))
        columns.append(at + (len(cell) - len(cell.lstrip(" ")) if cells[-1] else 0))
        at += len(cell) + 1
    return _Row(number, text, tuple(cells), tuple(columns))


def _character_fault(row: _Row, start: int) -> Finding | None:
    """Find why the cells of a line cannot be separated; `start` is its offset in bytes."""
    text = row.text
    escaped = _ESCAPED_BYTE.search(text)
    if escaped:
        offset = start + len(text[: escaped.start()].encode("utf-8"))
        message = f"the byte 0x{ord(escaped[0]) - 0xDC00:02X} at offset {offset} of the file is not UTF-8"
        if start == 0 and text.startswith(_IMAGE_STARTS):
            return row.finding(
                Code.NOT_UTF8, 1, message="the file is an image and not a map", fix="name the map's .cfg file"
            )
        utf16 = start == 0 and text.startswith(("\udcff\udcfe", "\udcfe\udcff"))
        fix = "save the file as UTF-8; it looks like " + ("UTF-16" if utf16 else "an older 8-bit encoding")
        return row.finding(Code.NOT_UTF8, escaped.start() + 1, message=message, fix=fix)
    if not text.strip(" "):
        message = "the line is blank, and more lines follow"
        return row.finding(Code.BLANK_LINE, 1, message=message, fix="delete the blank line")
    if len(text) > _LONGEST_LINE:
        message = f"the line has {len(text)} characters, more than {_LONGEST_LINE}"
        return row.finding(
            Code.WRONG_COLUMN_COUNT, 1, message=message, fix="break it into lines, or delete it"
        )
    control = _CONTROL.search(text)
    if control:
        name, fix = _CONTROL_NAMES.get(control[0], (f"the control character {control[0]!r}", "delete it"))
        return row.finding(Code.CONTROL_CHARACTER, control.start() + 1, message=f"there is {name}", fix=fix)
    if "\t" in text:
        fix = f"separate the columns by ';' only: {text.replace(chr(9), ';')}"
        return row.finding(
            Code.WRONG_SEPARATOR, text.index("\t") + 1, message="there is a tab in the line", fix=fix
        )
    return None


def _is_photo(row: _Row) -> bool:
    """Return whether a line can be read as a photo's, even if it is the first, where the image's belongs."""
    return len(row.cells) == 4 and (row.number > 1 or row.cells[0].isdecimal())


def _count_fault(row: _Row) -> Finding | None:
    grammar = "image;width;height" if row.number == 1 else "id;photo;x;y"
    wanted, have = grammar.count(";") + 1, row.text.count(";") + 1
    if have == wanted:
        return None
    if row.number == 1 and _is_photo(row):
        message = "the first line must name the satellite image, but it looks like a photo's"
        fix = "add a first line such as satellite.png;WIDTH;HEIGHT"
        return row.finding(Code.WRONG_COLUMN_COUNT, 1, message=message, fix=fix)
    if have == 1 and "," in row.text:
        message, fix = "the columns are separated by ',', not ';'", f"write {row.text.replace(',', ';')}"
        return row.finding(Code.WRONG_SEPARATOR, row.text.index(",") + 1, message=message, fix=fix)
    if have > wanted and not any(cell.strip("; ") for cell in row.cells[wanted:]):
        fix = f"write {';'.join(row.cells[:wanted])}"
    elif have > wanted:
        fix = "a name must not contain ';': rename the file, or delete the columns that are too many"
    elif have == wanted - 1 and _TWO_NUMBERS.fullmatch(row.cells[-1]):
        fix = f"write {';'.join([*row.cells[:-1], row.cells[-1].replace(',', ';')])}"
    else:
        fix = f"complete the line to {grammar}, or delete it"
    column = len(row.text) + 1 if have < wanted else row.columns[wanted]
    message = f"{have} column{'s' * (have != 1)} instead of {wanted}: {grammar}"
    return row.finding(Code.WRONG_COLUMN_COUNT, column, message=message, fix=fix)


def _image_line(row: _Row, faults: list[Finding]) -> ImageLine:
    return ImageLine(
        image=_field(row, 0, parse=parse_name, faults=faults),
        width=_field(row, 1, parse=lambda text: parse_size(text, "the width"), faults=faults),
        height=_field(row, 2, parse=lambda text: parse_size(text, "the height"), faults=faults),
        columns=(row.columns[0], row.columns[1], row.columns[2]),
    )


def _photo_line(row: _Row, free_ids: Iterator[int], faults: list[Finding]) -> PhotoLine:
    return PhotoLine(
        line=row.number,
        id=_field(row, 0, parse=parse_id, faults=faults, instead=lambda: str(next(free_ids))),
        photo=_field(row, 1, parse=parse_name, faults=faults),
        x=_field(row, 2, parse=lambda text: parse_coordinate(text, "x"), faults=faults),
        y=_field(row, 3, parse=lambda text: parse_coordinate(text, "y"), faults=faults),
        columns=(row.columns[0], row.columns[1], row.columns[2], row.columns[3]),
    )


def _field(
    row: _Row,
    cell: int,
    *,
    parse: Callable[[str], T],
    faults: list[Finding],
    instead: Callable[[], str] | None = None,
) -> T | None:
    """Parse one cell, or add its fault and the fix to `faults`."""
    try:
        return parse(row.cells[cell])
    except CfgFieldError as error:
        better = error.better or (instead() if instead else None)
        if better is not None:
            fix = f"write {row.corrected(cell, better)}"
        elif error.code in (Code.PATH_LEAVES_FOLDER, Code.EMPTY_NAME):
            fix = "put the file into the map's folder and write its path from there, such as photos/a.jpg"
        else:
            fix = "write a whole number of pixels, such as 20"
        faults.append(row.finding(error.code, row.columns[cell], message=error.message, fix=fix))
        return None
