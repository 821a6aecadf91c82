"""Reads text files: numbered lines, small files, and tables; escapes cells of CSV."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import BinaryIO

from webapp.core.columns import is_header
from webapp.errors import InputError, TableError, TrackError

MAX_LINE = 65_536
"""Bytes of one line."""

_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)

MAX_BYTES = 50_000_000
"""Larger files are refused: they must be something else."""

_ALPHABETS = {
    "cp1252": ("äöüß", "àâçéèêëîïôœùûüÿ", "áéíñóúü", "àèéìíîòóù", "áâãàçéêíóôõú", "åäöæøé", "éëïöüèê"),
    "cp1250": ("áčďéěíňóřšťúůýž", "áäčďéíĺľňóôŕšťúýž", "ąćęłńóśźż", "áéíóöőúüű", "čćđšž", "ăâîşţ"),
}
"""Code pages of Windows in Western and in Central Europe: letters of their languages besides a to z."""

_SAMPLE = 65_536
"""Bytes by which the code page of a file is chosen."""

_WORD = re.compile(r"[^\W\d_]+")
_DELIMITERS = (";", "\t", ",", "|", " ")
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True, slots=True)
class TextRow:
    fields: tuple[str, ...]  # As many as in the header
    where: str  # File and line

    def number(self, column: int) -> float:
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

    Args:
        error: Raised if the file is missing, unreadable, or larger than `MAX_BYTES`.
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
    """Read a small UTF-8 file, with or without a byte order mark; errors as for `read_bytes`."""
    try:
        return read_bytes(path, error=error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error("the file is not UTF-8 text", where=str(path), hint="save it as UTF-8") from problem


def read_table(path: Path, *, headers: Sequence[str]) -> tuple[str, list[TextRow]]:
    """Read a table of columns separated by semicolons under a header line.

    A byte order mark, CRLF and blank lines are accepted.

    Returns:
        header: The one found.
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
    """Yield the lines of a file with their numbers from 1, without line ends.

    Text is UTF-8, with or without a byte order mark; lines that are not UTF-8 are read in a code page of
    Windows, the one in which the first of them makes sense with what follows.
    """
    page = ""
    for number, line in enumerate(_lines(file), 1):
        if len(line) > MAX_LINE:
            raise TrackError(f"line {number} is longer than {MAX_LINE} bytes", hint="is it a text file?")
        if number == 1:
            if line.startswith(_WIDE):
                raise TrackError("the file is UTF-16 text", hint="save it as UTF-8")
            line = line.removeprefix(codecs.BOM_UTF8)
        try:
            text = line.decode()
        except UnicodeDecodeError:
            page = page or _code_page(line + _ahead(file))
            text = line.decode(page, "replace")
        yield number, text.rstrip("\r\n")


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file, which may end with carriage returns alone; too long ones are cut."""
    line = file.readline(MAX_LINE + 1)
    if line.endswith(b"\n") or b"\r" not in line[:-1]:
        while line:
            yield line
            line = file.readline(MAX_LINE + 1)
        return
    while line:
        *whole, line = line.split(b"\r")
        yield from whole
        more = file.read(MAX_LINE)
        if not more or len(line) > MAX_LINE:
            if line:
                yield line
            return
        line += more


def _ahead(file: BinaryIO) -> bytes:
    """Return what follows in a file, without moving on in it."""
    at = file.tell()
    following = file.read(_SAMPLE)
    file.seek(at)
    return following


def _code_page(sample: bytes) -> str:
    """Choose the code page with more known headers in the first line, or else more words of one language."""

    def sense(page: str) -> tuple[int, int]:
        text = sample.decode(page, "replace").lower()
        first = text.splitlines()[0]
        cells = split_row(first, delimiter_of(first) or ",")
        words = [set(word) for word in _WORD.findall(text) if not word.isascii()]
        letters = (set(alphabet + ascii_lowercase) for alphabet in _ALPHABETS[page])
        return sum(map(is_header, cells)), max(sum(word <= known for word in words) for known in letters)

    return max(_ALPHABETS, key=sense)


def delimiter_of(line: str) -> str | None:
    """Guess the delimiter of a line's fields; None if it has none."""
    return next((one for one in _DELIMITERS if one in line.strip()), None)


def split_row(line: str, delimiter: str) -> list[str]:
    """Split a line of a table into its fields, which may be quoted."""
    if delimiter == " ":
        return line.split()
    line = line.replace("\r", " ")  # the csv reader refuses one inside a line
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def plain_cell(value: object) -> object:
    """Escape a value for a CSV, so that no spreadsheet takes it for a formula.

    A text like `=HYPERLINK(...)` gets a leading apostrophe, so that spreadsheets show it as text; `cell_text`
    removes it. Numbers are not changed.
    """
    if not isinstance(value, str) or not _FORMULA.match(value) or _NUMBER.fullmatch(value):
        return value
    return f"'{value}"


def cell_text(cell: str) -> str:
    """Undo `plain_cell`."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
