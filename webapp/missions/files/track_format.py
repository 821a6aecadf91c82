"""What a format of track files is: the entry from which all of the program knows it."""

from __future__ import annotations

import codecs
import io
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, cast

from webapp.files.exchange.xml import local_name, walk
from webapp.files.text_file import numbered_lines
from webapp.missions.core.trajectory.axes import Axes
from webapp.missions.files.track_chunks import Findings, Piece

_HEAD = 4096
_XML_HEAD = 1_000_000
_LINES = 50
_BEFORE_JSON = b"\xef\xbb\xbf \t\r\n\x1e"
"""The last one begins each text of a sequence (RFC 8142)."""

_BEFORE_XML = b"\xef\xbb\xbf\xff\xfe \t\r\n\0"


@dataclass(frozen=True, slots=True)
class Selection:
    """What to read of a file."""

    topics: tuple[str, ...] = ()  # Only these topics of a bag, or lines of a KML; empty for all
    columns: str | None = None  # Meaning of the columns of a table; None to infer it
    axes: Axes | None = None  # Axes of frames in TUM, KITTI and tables; None to detect them


class Beginning:
    """The beginning of a file, by which its format is recognised; parts are read when they are asked for."""

    def __init__(self, path: Path) -> None:
        """Open a file; raises OSError."""
        self.path = path
        with path.open("rb") as file:
            self.head = file.read(_HEAD)

    @property
    def is_xml(self) -> bool:
        return self.head.lstrip(_BEFORE_XML).startswith(b"<")

    @property
    def is_text(self) -> bool:
        return bool(self.head) and b"\0" not in self.head and not self.is_xml

    @property
    def is_json(self) -> bool:
        return self.is_text and self.head.lstrip(_BEFORE_JSON).startswith((b"{", b"["))

    @cached_property
    def root(self) -> str:
        """Name of the root of an XML; empty for other files. Raises TrackError if the XML is damaged."""
        if not self.is_xml:
            return ""
        with self.path.open("rb") as file:
            head = without_blanks(file).read(_XML_HEAD)
        beginning = io.BytesIO(head)  # no endless comment, and no attribute of gigabytes
        _, root = next(walk(beginning, whole=()))
        return local_name(root)

    @cached_property
    def lines(self) -> list[str]:
        """The first lines of a text; none for other files."""
        if not self.is_text:
            return []
        with self.path.open("rb") as file:
            return [line for _, line in itertools.islice(numbered_lines(file), _LINES)]

    @property
    def content(self) -> str:
        """The first line of a text that is neither blank nor a comment; empty without one."""
        filled = (line for line in self.lines if line.strip() and not line.lstrip().startswith("#"))
        return next(filled, "")


Reader = Callable[[Path, Selection, Findings], Iterator[Piece]]


@dataclass(frozen=True, slots=True)
class FormatAbout:
    """What the documentation says about a format."""

    tracks: str  # What becomes tracks
    objects: str = ""  # What becomes objects
    left_out: str = ""
    written_by: str = ""  # Programs and devices


@dataclass(frozen=True, slots=True)
class TrackFormat:
    name: str
    title: str  # For display
    called: str  # In lists of formats, which name several with the same word once
    endings: tuple[str, ...]  # Of the names of such files; for choosing files only
    # Yields the pieces, before they are georeferenced. Raises TrackError, and UsageError if the selection
    # does not fit.
    read: Reader
    about: FormatAbout
    # A file is recognised by one of these rules; the second may raise TrackError for a damaged file.
    roots: frozenset[str] = frozenset()  # Names of the root of an XML
    is_one: Callable[[Beginning], bool] = lambda _: False
    needs: str = ""  # The extra that reading needs
    preload: tuple[str, ...] = ()  # Modules that its reading process imports before it is limited
    suffix: str | None = None  # Only bags: of their files, empty for a folder
    has_axes: bool = False  # Whether axes can be chosen
    numbered: str = ""  # First word of the ids that the reader generates for objects
    # Size of temporary files that reading writes, in multiples of the file's; None without a limit
    scratch: float | None = 0.0


def opened(read: Callable[[BinaryIO, Selection, Findings], Iterator[Piece]]) -> Reader:
    """Turn a reader of an open file into one of a path."""

    def reader(path: Path, selection: Selection, findings: Findings) -> Iterator[Piece]:
        with path.open("rb") as file:
            yield from read(without_blanks(file), selection, findings)

    return reader


def without_blanks(file: BinaryIO) -> BinaryIO:
    """Skip blanks before the declaration of an XML, which has to be first."""
    head = file.read(_HEAD)
    text = head.removeprefix(codecs.BOM_UTF8).lstrip(b" \t\r\n")
    skipped = len(head) - len(text) if text.startswith(b"<?xml") else 0
    file.seek(0)
    return cast(BinaryIO, _Later(file, skipped)) if skipped else file


class _Later(io.RawIOBase):
    """A file from a later byte on."""

    def __init__(self, file: BinaryIO, begin: int) -> None:
        self._file, self._begin = file, begin
        file.seek(begin)

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        return self._file.read(size)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = self._file.seek(offset + self._begin if whence == io.SEEK_SET else offset, whence)
        return at - self._begin
