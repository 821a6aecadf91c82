"""The list of query photos with true positions: the header `path;x;y`, then one line per photo."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, TypeVar

from webapp.core.geo.types import MapPixel
from webapp.errors import TableError, UsageError
from webapp.files import atomic

T = TypeVar("T")

HEADER = "path;x;y"
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True, slots=True)
class Query:
    name: str  # Its path as written in the list
    path: Path  # The same, joined with the folder of the list
    truth: MapPixel  # May lie outside the map's image, for a photo that was not taken on the map


def read(path: Path) -> list[Query]:
    """Read a list of queries.

    A byte order mark, CRLF line ends and blank lines at the end are accepted, no other deviation.
    Paths are relative to the folder of the list and may leave it; the photos are not opened.

    Raises:
        TableError: The file cannot be read, or breaks the format at a line and column.
    """
    lines = _text(path).split("\n")
    while len(lines) > 1 and not lines[-1].strip():
        lines.pop()
    if lines[0].removesuffix("\r") != HEADER:
        _refuse("the first line is not the header", path, (1, 1), hint=f"the first line must be {HEADER}")
    queries = [_query(line.removesuffix("\r"), path, number) for number, line in enumerate(lines[1:], 2)]
    if not queries:
        raise TableError("the list has no queries", where=str(path), hint="add one line per photo: path;x;y")
    return queries


def write(path: Path, queries: Sequence[Query]) -> None:
    """Write a list of queries, with absolute paths of their photos. Raises UsageError, StorageError."""
    lines = [HEADER]
    for query in queries:
        photo = str(query.path.resolve())
        if set(photo) & set(";\r\n"):
            raise UsageError(
                "the path has a semicolon or a line break", where=photo, hint="rename the photo or its folder"
            )
        lines.append(f"{photo};{query.truth.x!r};{query.truth.y!r}")
    atomic.write_text(path, "\n".join(lines) + "\n")


def select(items: Sequence[T], limit: int | None) -> list[T]:
    """Take `limit` of n items, evenly spread: those at `floor(i * n / limit)`.

    Args:
        limit: None, or at least the number of items, takes all.
    """
    if limit is None or limit >= len(items):
        return list(items)
    if limit < 1:
        raise UsageError("the limit must be at least 1", where="--limit")
    return [items[i * len(items) // limit] for i in range(limit)]


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TableError("the list is not UTF-8 text", where=str(path), hint="save it as UTF-8") from error
    except OSError as error:
        raise TableError(
            f"the list cannot be read: {error.strerror}", where=str(path), hint="check its path"
        ) from error


def _query(line: str, path: Path, number: int) -> Query:
    fields = line.split(";")
    if len(fields) != 3:
        _refuse(
            f"{len(fields)} columns instead of 3",
            path,
            (number, 1),
            hint="write path;x;y, with decimal points",
        )
    name = fields[0]
    if not name or "\0" in name:
        _refuse("the path of the photo is missing", path, (number, 1), hint="write path;x;y")
    x = _coordinate(fields[1], path, (number, len(name) + 2))
    y = _coordinate(fields[2], path, (number, len(name) + len(fields[1]) + 3))
    return Query(name, path.parent / name, MapPixel(x, y))


def _coordinate(text: str, path: Path, place: tuple[int, int]) -> float:
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        hint = "use a decimal point" if "," in text else "write map pixels as a plain number"
        _refuse(f"{text!r} is not a number", path, place, hint=hint)
    return value


def _refuse(message: str, path: Path, place: tuple[int, int], *, hint: str) -> NoReturn:
    raise TableError(message, where=f"{path}:{place[0]}:{place[1]}", hint=hint)
