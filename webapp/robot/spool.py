"""What a robot has to say, on its own disk first: the folder of a spool.

::

    SPOOL/
      spool.json             whose it is: its id, the mission, the server
      records-000000000000.log  the records, see `segments`
      state.log              how far the server has acknowledged them
      aside.log              what the server does not have, and why: refused, damaged, cut off
      photos/                photos that wait, see `photos`
      lock

Every record has a number. The server wants numbers without gaps, so what is set aside does not count there:
the state has both `next`, the first record that is not acknowledged, and `wire`, its number at the server.
Records go out only when they are on the disk, and `sent` says up to which one that may have happened: no
number is ever given to a second record.
"""

from __future__ import annotations

import json
import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from webapp.errors import DiskFull, InputError
from webapp.robot.disk import FolderLock, is_full, told
from webapp.robot.frames import lines
from webapp.robot.identity import Identity, read_identity, take_over
from webapp.robot.journal import Journal, entries
from webapp.robot.options import RobotOptions
from webapp.robot.photos import PhotoNote, PhotoQueue, WaitingPhoto
from webapp.robot.segments import Gap, Run, SegmentReader, SegmentWriter

_STATE_BYTES = 100_000

MAX_RECORD = 100_000
"""Bytes of the longest record."""


@dataclass(frozen=True, slots=True)
class State:
    """How far the server has acknowledged.

    Attributes
    ----------
    next, wire, sent : int
        See the module.
    """

    next: int = 0
    wire: int = 0
    sent: int = 0


class Spool:
    """The folder, opened by its only writer.

    Records and photos are added, and synced, by any thread; all else is for the one thread that sends.

    Parameters
    ----------
    folder : Path
        Is made where it is missing.
    identity : Identity, optional
        Of a new spool, without `id`; None for one that must exist. An existing one has to be of the same
        mission and about the same; its `url` may be another.
    options : RobotOptions, optional

    Raises
    ------
    UsageError
        The spool is another mission's, or there is none.
    Conflict
        Another program has it open.
    StorageError, DiskFull
    """

    def __init__(
        self, folder: Path, *, identity: Identity | None = None, options: RobotOptions | None = None
    ) -> None:
        self.folder = folder
        self._options = options or RobotOptions()
        self._guard = threading.RLock()
        if identity is None:
            read_identity(folder)  # there must be one, and no folder is made
        with told(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = FolderLock(folder)
        try:
            self.identity = take_over(folder, identity)
            self._open()
        except BaseException:
            self._lock.release()
            raise

    def _open(self) -> None:
        self._states = Journal(self.folder / "state.log")
        self._aside = Journal(self.folder / "aside.log")
        self.state = read_state(self.folder)
        size = int(self._options.segment_kb * 1000)
        self._writer = SegmentWriter(self.folder, at_least=self.state.sent, segment_bytes=size)
        self._reader = SegmentReader(self.folder)
        self.photos = PhotoQueue(self.folder / "photos")
        if self.torn:
            self._note(f"{self.torn} bytes of an unfinished record were cut off")
        for name in self.photos.damaged:
            self._note("a photo or its note is damaged", photo=f"photos/{name}")
        self._skips = self._put_aside(since=self.state.next)

    def travelled_m(self, track: tuple[str, str]) -> float:
        """Tell how far a track had come with the last pose of it; 0 where that is not known.

        Parameters
        ----------
        track : tuple of str
            Source and name.
        """
        travelled = 0.0
        for segment in self._writer.segments[-2:]:
            for line in lines(segment.path):
                if line.record is None or b"travelled_m" not in line.record.text:
                    continue
                pose = json.loads(line.record.text)
                if (pose.get("source", "gps"), pose.get("track", "")) == track:
                    travelled = pose["travelled_m"]
        return travelled

    @property
    def torn(self) -> int:
        """Bytes of unfinished records that were cut off when the spool was opened."""
        return self._writer.torn

    @property
    def next(self) -> int:
        """Number of the record that comes next."""
        return self._writer.next

    @property
    def waiting(self) -> int:
        """Records that the server has not acknowledged."""
        return self._writer.next - self.state.next

    @property
    def size(self) -> int:
        """Bytes of records and photos."""
        return self._writer.size + self.photos.size

    def append(self, text: bytes, *, sync: bool) -> int:
        """Add a record.

        Parameters
        ----------
        text : bytes
            JSON on one line.
        sync : bool
            Return when it survives a power cut. Otherwise it survives a kill, and a power cut only after the
            next `sync`.

        Returns
        -------
        int
            Its number.

        Raises
        ------
        DiskFull
            It was not added.
        """
        if len(text) > MAX_RECORD:
            raise InputError(
                f"the record has {len(text)} bytes, at most {MAX_RECORD} are taken",
                hint="send less in one record",
            )
        with self._guard, told(self.folder):
            self._make_room(len(text))
            number = self._append(text)
            if sync:
                self._writer.sync()
            return number

    def add_photo(self, source: BinaryIO, *, name: str, time: float, object_id: str | None) -> PhotoNote:
        """Take a photo over; when this returns, it survives a power cut.

        Raises
        ------
        DiskFull
            It was not taken over.
        """
        size = source.seek(0, os.SEEK_END)
        source.seek(0)
        with self._guard:
            self._make_room(size)
            return self.photos.add(source, name=name, time=time, object_id=object_id)

    def sync(self) -> None:
        """Have all records on the disk. Others may add some meanwhile."""
        with told(self.folder):
            with self._guard:
                if self._writer.durable == self._writer.next:
                    return
                descriptor, end = self._writer.copy()
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        self._writer.synced(end)

    def read(self, *, records: int, size: int) -> Run | Gap | None:
        """Read the records to send next, having them on the disk first.

        Parameters
        ----------
        records, size : int
            At most so many, and so many bytes.

        Returns
        -------
        Run, Gap or None
            A gap where the next record is damaged; None when all are acknowledged.
        """
        self._skip()
        self.sync()
        end = min(
            (number for number in self._skips if number > self.state.next), default=self._writer.durable
        )
        with told(self.folder):
            return self._reader.read(
                self.state.next, end=min(end, self._writer.durable), records=records, size=size
            )

    def mark_sent(self, end: int) -> None:
        """Remember that records below `end` may reach the server."""
        if end > self.state.sent:
            self._keep(State(self.state.next, self.state.wire, end))

    def acknowledge(self, count: int) -> None:
        """Remember that the server has the next `count` records."""
        end = self.state.next + count
        # Forgotten in a power cut, they are sent again, and the server knows that it has them.
        self._keep(State(end, self.state.wire + count, max(self.state.sent, end)), sync=False)

    def set_aside(self, count: int, *, reason: str, text: bytes | None = None) -> None:
        """Go on behind the next `count` records, which the server does not have and will not get.

        Parameters
        ----------
        count : int
        reason : str
        text : bytes, optional
            The record itself.
        """
        first = self.state.next
        record = {} if text is None else {"record": json.loads(text)}
        self._note(reason, first=first, count=count, **record)
        self._skips.update(range(first, first + count))
        self._skip()

    def refuse_photo(self, photo: WaitingPhoto, *, reason: str) -> None:
        """Put a photo out of the way that the server does not want."""
        self._note(reason, photo=f"photos/refused/{self.photos.refused(photo).name}")

    def rewind(self, wire: int) -> bool:
        """Go back to the record that has this number at the server, which has lost it.

        Returns
        -------
        bool
            False where the record is not here any more.
        """
        aside = self._put_aside(since=0)
        number, back = self.state.next, self.state.wire - wire
        while back > 0:
            number -= 1
            back -= number not in aside
        if number < self._writer.segments[0].first:
            return False
        self._skips = {skipped for skipped in aside if skipped >= number}
        self._keep(State(number, wire, self.state.sent))
        return True

    def close(self) -> None:
        """Have everything on the disk, and let others open the spool."""
        with self._guard, told(self.folder):
            self._writer.close()
            self._states.close()
            self._aside.close()
            self._lock.release()

    def _append(self, text: bytes) -> int:
        while True:
            try:
                return self._writer.append(text)
            except OSError as error:
                if not (is_full(error) and self._writer.forget_oldest(self.state.next)):
                    raise

    def _make_room(self, size: int) -> None:
        limit = self._options.limit_mb * 1e6
        while self.size + size > limit:
            if not self._writer.forget_oldest(self.state.next):
                raise DiskFull(
                    f"the spool is full: {self.size / 1e6:.1f} of {self._options.limit_mb:g} MB",
                    where=str(self.folder),
                    hint="bring the robot where there is a network, or allow the spool more",
                )

    def _note(self, reason: str, **more: object) -> None:
        self._aside.append({"first": self._writer.next, "count": 0, "reason": reason} | more)

    def _put_aside(self, *, since: int) -> set[int]:
        ranges = [(entry["first"], entry["first"] + entry["count"]) for entry in read_aside(self.folder)]
        return {number for first, end in ranges for number in range(max(first, since), end)}

    def _skip(self) -> None:
        following = self.state.next
        while following in self._skips:
            self._skips.remove(following)
            following += 1
        if following > self.state.next:
            self._keep(State(following, self.state.wire, self.state.sent))

    def _keep(self, state: State, *, sync: bool = True) -> None:
        entry = {"next": state.next, "wire": state.wire, "sent": state.sent}
        if self._states.size > _STATE_BYTES:
            self._states.replace(entry)
        else:
            self._states.append(entry, sync=sync)
        self.state = state


def read_state(folder: Path) -> State:
    """Read how far the server has acknowledged."""
    last = None
    for entry in entries(folder / "state.log"):
        last = entry
    return State(**last) if last else State()


def read_aside(folder: Path) -> list[dict[str, Any]]:
    """Read what the server does not have: `first` and `count` of the records, `reason`, maybe `record`."""
    return list(entries(folder / "aside.log"))
