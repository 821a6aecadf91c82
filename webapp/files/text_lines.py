"""Lines of text files of any size."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import BinaryIO

from webapp.errors import TrackError

MAX_LINE = 65_536
"""Bytes of one line."""

_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def numbered_lines(file: BinaryIO) -> Iterator[tuple[int, str]]:
    """Give the lines of a file with their numbers from 1, without the ends of lines.

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
