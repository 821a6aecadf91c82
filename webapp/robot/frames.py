"""A record as a line of a file: checksum, number, text.

::

    5d41402a 17 {"type":"pose","time":1432235498.04,"lat":42.375812,"lon":-71.147394}

The checksum, CRC-32 in hexadecimal, covers all that follows it on its line. The text holds no line end, so
that behind a damaged line the next one is found again; and people can read the file.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

_CRC_BYTES = 8

MAX_LINE = 1 << 20
"""Bytes of the longest line; longer ones are damaged."""


class Record(NamedTuple):
    """A number and the text that belongs to it."""

    number: int
    text: bytes


class Line(NamedTuple):
    """A line of a file, whatever its state.

    Attributes
    ----------
    start, end : int
        Bytes from the beginning of the file; the line end belongs to it.
    record : Record or None
        None where the line is damaged or unfinished.
    """

    start: int
    end: int
    record: Record | None


def encode(number: int, text: bytes) -> bytes:
    """Make a line.

    Parameters
    ----------
    number : int
        Not negative.
    text : bytes
        Without line ends.
    """
    covered = b"%d %s" % (number, text)
    return b"%08x %s\n" % (zlib.crc32(covered), covered)


def decode(line: bytes) -> Record | None:
    """Read a line; None where it is not exactly as it was written."""
    covered = line[_CRC_BYTES + 1 : -1]
    number, space, text = covered.partition(b" ")
    if not space or not number.isdigit():
        return None
    made = Record(int(number), text)
    return made if encode(*made) == line else None


def lines(path: Path, *, start: int = 0) -> Iterator[Line]:
    """Read a file line by line, as it is now.

    Parameters
    ----------
    path : Path
    start : int
        Bytes from the beginning of the file, where a line begins.
    """
    with path.open("rb") as file:
        file.seek(start)
        while line := _line(file):
            end = start + len(line)
            yield Line(start, end, decode(line))
            start = end


def _line(file: BinaryIO) -> bytes:
    """Read to the end of a line, or as much as one may have."""
    return file.readline(MAX_LINE)


def valid_end(path: Path) -> int:
    """Tell where the last line that is as it was written ends; 0 where there is none."""
    return max((line.end for line in lines(path) if line.record is not None), default=0)
