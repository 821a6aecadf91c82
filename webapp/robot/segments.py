"""The records of a spool, in files of which only the last one grows.

`records-000000000840.log` begins with record 840. What stands behind the last valid line of the last file was
being written when the power went: it is cut off when the spool is opened. Damage anywhere else stays where it
is, and whoever reads is told which records it has cost.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from webapp.robot.disk import sync_folder
from webapp.robot.frames import Line, encode, lines
from webapp.robot.journal import append_at

_NAME = "records-{:012d}.log"


class Segment(NamedTuple):
    """A file of records.

    Attributes
    ----------
    first : int
        Number of its first record.
    path : Path
    """

    first: int
    path: Path


def listed(folder: Path) -> list[Segment]:
    """List the files of records in a folder, in order."""
    found = (Segment(int(path.stem.partition("-")[2]), path) for path in folder.glob("records-*.log"))
    return sorted(found)


class Tail(NamedTuple):
    """The end of the last file of records.

    Attributes
    ----------
    next : int
        Number of the record that comes next.
    end : int
        Bytes up to the end of the last valid line.
    torn : int
        Bytes behind it.
    """

    next: int
    end: int
    torn: int


def tail(segment: Segment) -> Tail:
    """Find where the records of a file end."""
    following, valid, end = segment.first, 0, 0
    for line in lines(segment.path):
        end = line.end
        if line.record is not None:
            following, valid = line.record.number + 1, line.end
    return Tail(following, valid, end - valid)


class SegmentWriter:
    """Appends records.

    Parameters
    ----------
    folder : Path
    at_least : int
        The number of the next record is not smaller: those below have left the robot, even if they are
        damaged here.
    segment_bytes : int
        A file that has so many is followed by a new one.
    """

    def __init__(self, folder: Path, *, at_least: int, segment_bytes: int) -> None:
        self._folder = folder
        self._segment_bytes = segment_bytes
        self._closed_bytes = self._end = 0
        self.segments = listed(folder)
        self.torn = 0
        """Bytes that were cut off."""
        if self.segments:
            found = tail(self.segments[-1])
            self.next, self._end, self.torn = max(found.next, at_least), found.end, found.torn
            self._descriptor = _open(self.segments[-1].path)
            os.ftruncate(self._descriptor, found.end)
            os.fsync(self._descriptor)
        else:
            self.next = at_least
            self._begin()
        self.durable = self.next
        """Records below are on the disk, whatever happens to the power."""
        self._closed_bytes = sum(segment.path.stat().st_size for segment in self.segments[:-1])

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return self._closed_bytes + self._end

    def append(self, text: bytes) -> int:
        """Add a record; a kill cannot undo it, a power cut can until `sync`.

        Returns
        -------
        int
            Its number.
        """
        if self._end >= self._segment_bytes:
            self.sync()
            full = self._descriptor
            self._begin()
            os.close(full)
        line = encode(self.next, text)
        append_at(self._descriptor, line, end=self._end)
        self._end += len(line)
        self.next += 1
        return self.next - 1

    def sync(self) -> None:
        """Have everything on the disk."""
        if self.durable < self.next:
            os.fsync(self._descriptor)
            self.durable = self.next

    def copy(self) -> tuple[int, int]:
        """Give another descriptor of the file that grows, and the number of the next record.

        Who has synced it without holding up `append` calls `synced`.
        """
        return os.dup(self._descriptor), self.next

    def synced(self, end: int) -> None:
        """Note that the records below `end` are on the disk."""
        self.durable = max(self.durable, end)

    def forget_oldest(self, below: int) -> bool:
        """Delete the oldest file if all its records have numbers below that; tell whether it was deleted."""
        if len(self.segments) < 2 or self.segments[1].first > below:
            return False
        oldest = self.segments.pop(0)
        self._closed_bytes -= oldest.path.stat().st_size
        oldest.path.unlink()
        return True

    def close(self) -> None:
        """Have everything on the disk, and close the file."""
        self.sync()
        os.close(self._descriptor)

    def _begin(self) -> None:
        path = self._folder / _NAME.format(self.next)
        descriptor = _open(path)
        sync_folder(self._folder)
        self.segments.append(Segment(self.next, path))
        self._descriptor, self._closed_bytes, self._end = descriptor, self._closed_bytes + self._end, 0


def _open(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644)


@dataclass(frozen=True, slots=True)
class Run:
    """Records one after the other.

    Attributes
    ----------
    first : int
        Number of the first.
    texts : tuple of bytes
    """

    first: int
    texts: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Gap:
    """Records that are damaged, or whose file is missing.

    Attributes
    ----------
    first, count : int
    """

    first: int
    count: int


class SegmentReader:
    """Reads records in order, and remembers where the last one ended.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._place: tuple[int, Path, int] | None = None
        """A record, its file, and where in it its line begins."""

    def read(self, first: int, *, end: int, records: int, size: int) -> Run | Gap | None:
        """Read records from a number on.

        Parameters
        ----------
        first, end : int
            Of records `first` to `end - 1`.
        records, size : int
            At most so many, and so many bytes; but always one.

        Returns
        -------
        Run, Gap or None
            A gap where the first one is damaged; None where `first` is `end`.
        """
        if first >= end:
            return None
        texts: list[bytes] = []
        total = 0
        for path, line in self._lines(first):
            if line.record is None or line.record.number < first:
                continue
            number, text = line.record
            following = first + len(texts)
            if number >= end or number != following:
                if not texts:
                    return Gap(first, min(number, end) - first)
                break
            if texts and (len(texts) == records or total + len(text) > size):
                self._place = (number, path, line.start)
                break
            texts.append(text)
            total += len(text)
            self._place = (number + 1, path, line.end)
            if number + 1 == end:
                break
        return Run(first, tuple(texts)) if texts else Gap(first, end - first)

    def _lines(self, first: int) -> Iterator[tuple[Path, Line]]:
        start = 0
        segments = listed(self._folder)
        # The last file that begins at or before the record, and those behind it.
        begun = [index for index, segment in enumerate(segments) if segment.first <= first]
        if begun:
            segments = segments[begun[-1] :]
        if self._place is not None and segments and self._place[:2] == (first, segments[0].path):
            start = self._place[2]
        for segment in segments:
            for line in lines(segment.path, start=start):
                yield segment.path, line
            start = 0
