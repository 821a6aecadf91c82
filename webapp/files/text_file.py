"""Text files: lines with numbers; small files and semicolon tables, and one error for all that goes wrong."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from webapp.errors import InputError, TableError, TrackError

MAX_LINE = 65_536
"""Bytes of one line."""

_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)

MAX_BYTES = 50_000_000
"""A larger file is not what it was taken for."""

_DELIMITERS = (";", "\t", ",", "|", " ")
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True, slots=True)
class TextRow:
    """One line of a table.

    Attributes
    ----------
    fields : tuple of str
        As many as the header has.
    where : str
        File and line.
    """

    fields: tuple[str, ...]
    where: str

    def number(self, column: int) -> float:
        """Return a column as a finite number.

        Raises
        ------
        TableError
            It is not valid.
        """
        text = self.fields[column].strip()
        value = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(value):
            hint = "use a decimal point" if "," in text else "write a plain number"
            raise TableError(
                f"{text[:40]!r} in column {column + 1} is not a number", where=self.where, hint=hint
            )
        return value


def read_bytes(path: Path, *, error: type[InputError]) -> bytes:
    """Read a small file.

    Parameters
    ----------
    error : type
        Raised when there is none, it may not be read, or it is larger than `MAX_BYTES`.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as problem:
        message = f"the file cannot be read: {problem.strerror or problem}"
        raise error(message, where=str(path), hint="check its path") from problem
    if len(data) > MAX_BYTES:
        raise error(
            f"the file is larger than {MAX_BYTES // 10**6} MB", where=str(path), hint="is it the right one?"
        )
    return data


def read_text(path: Path, *, error: type[InputError]) -> str:
    """Read a small file of UTF-8 text, with or without a byte order mark; errors as `read_bytes`."""
    try:
        return read_bytes(path, error=error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error("the file is not UTF-8 text", where=str(path), hint="save it as UTF-8") from problem


def read_table(path: Path, *, headers: Sequence[str]) -> tuple[str, list[TextRow]]:
    """Read a table of columns separated by semicolons under a header line.

    A byte order mark, CRLF and blank lines are accepted.

    Parameters
    ----------
    headers : sequence of str
        The headers that are understood, such as `x;y;lat;lon`.

    Returns
    -------
    header : str
        The one it has.

    Raises
    ------
    TableError
        The file cannot be read, has another header, or a line has another number of columns.
    """
    lines = read_text(path, error=TableError).splitlines() or [""]
    header = lines[0].strip().replace(" ", "").lower()
    if header not in headers:
        hint = "the first line must be " + " or ".join(headers)
        raise TableError("the first line is not the header", where=f"{path}:1", hint=hint)
    rows = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        fields = tuple(line.split(";"))
        if len(fields) != header.count(";") + 1:
            message = f"{len(fields)} columns instead of {header.count(';') + 1}"
            raise TableError(message, where=f"{path}:{number}", hint=f"write {header}, with decimal points")
        rows.append(TextRow(fields, f"{path}:{number}"))
    return header, rows


def numbered_lines(file: BinaryIO) -> Iterator[tuple[int, str]]:
    """Return the lines of a file with their numbers from 1, without the ends of lines.

    Text is UTF-8, with or without a byte order mark; bytes that are not are read as Latin-1, line by line.

    Raises
    ------
    TrackError
        A line is longer than any in a text of positions, or the file is UTF-16.
    """
    number = 0
    while line := file.readline(MAX_LINE + 1):
        number += 1
        if len(line) > MAX_LINE:
            raise TrackError(f"line {number} is longer than {MAX_LINE} bytes", hint="is it a text file?")
        if number == 1:
            if line.startswith(_WIDE):
                raise TrackError("the file is UTF-16 text", hint="save it as UTF-8")
            line = line.removeprefix(codecs.BOM_UTF8)
        yield number, _decoded(line).rstrip("\r\n")


def _decoded(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def delimiter_of(line: str) -> str | None:
    """Guess what separates the fields of a line; None where nothing does."""
    return next((one for one in _DELIMITERS if one in line.strip()), None)


def split_row(line: str, delimiter: str) -> list[str]:
    """Split a line of a table into its fields, some of them perhaps quoted."""
    if delimiter == " ":
        return line.split()
    line = line.replace("\r", " ")  # for the reader, the end of a line: it refuses one in the middle
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def plain_cell(value: object) -> object:
    """Return a value for a CSV that no spreadsheet takes for a formula.

    A text like `=HYPERLINK(...)` gets an apostrophe in front, with which spreadsheets show it as a text;
    `cell_text` takes it away again. Numbers stay.
    """
    if not isinstance(value, str) or not _FORMULA.match(value) or _NUMBER.fullmatch(value):
        return value
    return f"'{value}"


def cell_text(cell: str) -> str:
    """Return the text that `plain_cell` was given."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
