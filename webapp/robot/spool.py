"""The spool: a folder on the robot's disk for the data to send.

::

    SPOOL/
      data/spool.sqlite3  identity, records, state of the acknowledgements, records set aside
      data/photos/        photos waiting to be sent
      damaged-1/          an earlier `data`, whose database was damaged
      reserve             disk space for acknowledgements when the disk is full
      lock.sqlite3

Every record has a number. The server expects numbers without gaps, and records that are set aside are not
sent, so its numbering differs: the state holds both `next`, the first record that is not acknowledged, and
`wire`, its number at the server. Records are sent only when they are on the disk, and `sent` is the number up
to which they may have been sent: even if the database is damaged, no number is used twice. Acknowledged
records stay in the spool until their space is needed, in case the server is restored from a backup.
"""

from __future__ import annotations

import itertools
import json
import os
import time
import uuid
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from .database import DAMAGED, DatabaseDamaged, FolderLock, SpoolDatabase, Statement, storage_errors
from .errors import DiskFull, InputError, UsageError
from .options import RobotOptions
from .photos import PhotoQueue, WaitingPhoto
from .salvage import quarantine, salvage
from .schema import IDENTITY, Identity, check_version, create_tables

MAX_RECORD = 100_000
"""Maximum size of a record, bytes."""

_FORGET_RECORDS = 500
_READ_RECORDS = 50
_RECENT_RECORDS = 20_000


@dataclass(frozen=True, slots=True)
class SpoolState:
    """Progress of sending; see the docstring of the module."""

    next: int = 0
    wire: int = 0
    sent: int = 0


@dataclass(frozen=True, slots=True)
class RecordRun:
    """Consecutive records as JSON, numbered from `first`."""

    first: int
    texts: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Gap:
    """Consecutive records that are damaged or missing."""

    first: int
    count: int


class Spool:
    """A spool, opened by its only writer.

    Any thread may add and sync records and photos; only the uploading thread may call the other methods.

    Args:
        folder: Created if missing.
        identity: `id` is ignored. An existing spool must have the same `mission` and `about`; its `url` may
            differ.

    Raises:
        UsageError: The spool is of another mission or `about`, or of version 0.7.0.
        Conflict: Another program has it open.
        StorageError, DiskFull
    """

    def __init__(self, folder: Path, *, identity: Identity, options: RobotOptions | None = None) -> None:
        self.folder = folder
        self._options = options or RobotOptions()
        check_version(folder)
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = FolderLock(folder)
        try:
            self._open(identity)
        except BaseException:
            self._lock.release()
            raise

    @property
    def waiting(self) -> int:
        """Records that the server has not acknowledged."""
        return self.next - self.state.next

    @property
    def size(self) -> int:
        """Bytes of records and photos."""
        return self._database.used_bytes + self.photos.size

    def travelled_m(self, track: tuple[str, str]) -> float:
        """Return `travelled_m` of the last pose of a track (source and name), or 0 if unknown."""
        for text in self.recent():
            if b'"travelled_m"' in text:
                pose = json.loads(text)
                if (pose.get("source", "gps"), pose.get("track", "")) == track and "travelled_m" in pose:
                    return float(pose["travelled_m"])
        return 0.0

    def recent(self) -> Iterator[bytes]:
        """Yield the last 20 000 records as JSON, newest first; acknowledged ones may have been deleted."""
        rows = self._database.select(
            "SELECT CAST(text AS BLOB) FROM records ORDER BY number DESC LIMIT ?", _RECENT_RECORDS
        )
        yield from (text for (text,) in rows)

    def append(self, text: bytes, *, sync: bool) -> int:
        """Add a record.

        Args:
            text: JSON.
            sync: Return only when the record survives a power cut. Otherwise it survives a killed process,
                and a power cut only after the next `sync`.

        Returns:
            Its number.

        Raises:
            DiskFull, StorageError: The record was not added.
        """
        if len(text) > MAX_RECORD:
            raise InputError(
                f"the record has {len(text)} bytes, more than the limit of {MAX_RECORD}",
                hint="send less in one record",
            )
        with self._database.guard:
            self._make_room(len(text))
            number = self.next
            insert = (
                "INSERT INTO records (number, crc, text) VALUES (?, ?, CAST(? AS TEXT))",
                (number, _crc(number, text), text),
            )
            while True:
                try:
                    self._database.write(insert, durable=sync, size=len(text))
                except DiskFull:
                    if not self._delete_acknowledged():
                        raise
                else:
                    self.next += 1
                    return number

    def add_photo(self, source: BinaryIO, *, name: str, time: float, object_id: str | None) -> str:
        """Store a photo; when this returns, it survives a power cut.

        Returns:
            SHA-256, hexadecimal.

        Raises:
            DiskFull, StorageError: The photo was not stored.
        """
        size = source.seek(0, os.SEEK_END)
        source.seek(0)
        with self._database.guard:
            self._make_room(size)
            return self.photos.add(source, name=name, time=time, object_id=object_id)

    def sync(self) -> None:
        """Sync all records to the disk. Others may add some meanwhile."""
        self._database.sync()

    def next_batch(self, *, records: int, size: int) -> RecordRun | Gap | None:
        """Read the records to send next, limited in number and size, and make sure that they are synced.

        Returns:
            A gap if the next record is damaged; None if all are acknowledged.
        """
        end = self._skip_set_aside()
        first = self.state.next
        if first >= end:
            return None
        texts: list[bytes] = []
        for text in self._texts(first, end=min(end, first + records)):
            size -= 0 if text is None else len(text)
            if text is None or (texts and size < 0):
                break
            texts.append(text)
        if not texts:
            damaged = itertools.takewhile(lambda text: text is None, self._texts(first, end=end))
            return Gap(first, sum(1 for _ in damaged))
        if first + len(texts) > self.state.sent:
            self._save(replace(self.state, sent=first + len(texts)), durable=True)
        return RecordRun(first, tuple(texts))

    def acknowledge(self, count: int) -> None:
        """Record that the server has the next `count` records."""
        end = self.state.next + count
        # Not durable: after a power cut they are sent again, and the server recognises their numbers.
        self._save(SpoolState(end, self.state.wire + count, max(self.state.sent, end)))
        self._database.make_reserve()

    def set_aside(self, count: int, *, reason: str, text: bytes | None = None) -> None:
        """Skip the next `count` records, which will not be sent, and note the reason.

        Args:
            text: The record itself.
        """
        first, end = self.state.next, self.state.next + count
        record = None if text is None else text.decode()
        aside = (
            "INSERT INTO aside (first, stop, reason, record) VALUES (?, ?, ?, ?)",
            (first, end, reason, record),
        )
        self._save(replace(self.state, next=end), aside, durable=True)

    def set_photo_aside(self, photo: WaitingPhoto, *, reason: str) -> None:
        """Keep a photo that will not be sent, with the reason."""
        self.photos.set_aside(photo, reason=reason, next_number=self.next)

    def rewind(self, wire: int) -> bool:
        """Go back to the record with this number at the server, because the server has lost it.

        Returns:
            False if the record has been deleted here.
        """
        number, back = self.state.next, self.state.wire - wire
        for first, end in self._database.select(
            "SELECT first, stop FROM aside WHERE stop > first ORDER BY stop DESC"
        ):
            if end <= number:
                if number - end >= back:
                    break
                back -= number - end
                number = first
        number -= back
        oldest = self._database.select("SELECT min(number) FROM records")[0][0]
        if oldest is None or number < oldest:
            return False
        self._save(SpoolState(number, wire, self.state.sent))
        return True

    def close(self) -> None:
        """Sync everything to the disk, and release the spool."""
        try:
            self._database.close()
        finally:
            self._lock.release()

    def _open(self, wanted: Identity) -> None:
        data = self.folder / "data"
        if (data / DAMAGED).exists():
            quarantine(self.folder)
        try:
            salvage(self.folder)
            self._load(wanted)
        except DatabaseDamaged:
            quarantine(self.folder)
            salvage(self.folder)
            self._load(wanted)

    def _load(self, wanted: Identity) -> None:
        self._database = SpoolDatabase(self.folder / "data", reserve=self.folder / "reserve")
        try:
            create_tables(self._database)
            self.identity = self._claim(wanted)
            self.state = SpoolState(*self._database.select("SELECT next, wire, sent FROM spool")[0])
            last = self._database.select("SELECT max(number) FROM records")[0][0]
            self.next = max(self.state.sent, -1 if last is None else last + 1)
            self.photos = PhotoQueue(self._database)
            for photo in self.photos.damaged:
                self.set_photo_aside(photo, reason="the photo is damaged on the disk of the robot")
        except BaseException:
            self._database.close()
            raise

    def _claim(self, wanted: Identity) -> Identity:
        """Check the identity of the spool; store it if the spool is new."""
        rows = self._database.select(IDENTITY)
        if not rows:
            made = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
            found = Identity(uuid.uuid4().hex, wanted.mission, wanted.url, wanted.about)
            self._database.write(
                (
                    "INSERT INTO spool (one, id, mission, url, about, made) VALUES (1, ?, ?, ?, ?, ?)",
                    (found.id, found.mission, found.url, found.about, made),
                ),
                durable=True,
            )
            return found
        found = Identity(*rows[0])
        if found.mission != wanted.mission:
            problem = f"the spool is of mission {found.mission}, not {wanted.mission}"
            raise UsageError(problem, where=str(self.folder), hint="choose another folder")
        if found.about != wanted.about:
            problem = f"the spool holds something else: {found.about or 'what a robot sent'}"
            raise UsageError(problem, where=str(self.folder), hint="choose another folder")
        if found.url != wanted.url:
            self._database.write(("UPDATE spool SET url = ?", (wanted.url,)), durable=True, urgent=True)
        return replace(found, url=wanted.url)

    def _save(self, state: SpoolState, *more: Statement, durable: bool = False) -> None:
        update = ("UPDATE spool SET next = ?, wire = ?, sent = ?", (state.next, state.wire, state.sent))
        self._database.write(*more, update, durable=durable, urgent=True)
        self.state = state

    def _skip_set_aside(self) -> int:
        """Skip records set aside before a rewind; return where the next such records begin, or the end."""
        while True:
            rows = self._database.select(
                "SELECT first, stop FROM aside WHERE stop > ? AND stop > first ORDER BY stop LIMIT 1",
                self.state.next,
            )
            if not rows or rows[0][0] > self.state.next:
                return int(rows[0][0]) if rows else self.next
            self._save(replace(self.state, next=rows[0][1]))

    def _texts(self, first: int, *, end: int) -> Iterator[bytes | None]:
        """Read records; None for one that is damaged or missing."""
        for begin in range(first, end, _READ_RECORDS):
            yield from self._some_texts(begin, end=min(begin + _READ_RECORDS, end))

    def _some_texts(self, first: int, *, end: int) -> list[bytes | None]:
        query = "SELECT number, crc, CAST(text AS BLOB) FROM records WHERE number >= ? AND number < ?"
        try:
            rows = self._database.select(query, first, end, tolerant=True)
        except DatabaseDamaged:
            if end - first == 1:
                return [None]
            middle = (first + end) // 2
            return self._some_texts(first, end=middle) + self._some_texts(middle, end=end)
        whole = {number: text for number, crc, text in rows if text is not None and crc == _crc(number, text)}
        return [whole.get(number) for number in range(first, end)]

    def _make_room(self, size: int) -> None:
        limit = self._options.limit_mb * 1e6
        while self.size + size > limit:
            if not self._delete_acknowledged():
                raise DiskFull(
                    f"the spool is full: {self.size / 1e6:.1f} of {self._options.limit_mb:g} MB",
                    where=str(self.folder),
                    hint="connect the robot to a network, or raise the spool's limit",
                )

    def _delete_acknowledged(self) -> int:
        """Delete the oldest records that the server has; return how many."""
        return self._database.write(
            (
                "DELETE FROM records WHERE number < (SELECT min(next) FROM spool) AND number IN"
                " (SELECT number FROM records ORDER BY number LIMIT ?)",
                (_FORGET_RECORDS,),
            ),
            urgent=True,
        )


def _crc(number: int, text: bytes) -> int:
    """Return the checksum of a record; the database itself has none."""
    return zlib.crc32(text, zlib.crc32(b"%d" % number))
