"""Objects cached on the disk of this machine, up to a size limit, and the pointers to them.

::

    CACHE/ab/abcd...-0123...-IMG_1.jpg    an object: its key, and the name of its file

Recently requested files are not evicted, so that callers have time to open the path they got; files that are
open or mapped stay readable after deletion. The access time (atime) of a file is that of the last request.
Files that a process has mapped are not evicted, either: deleting them would free no space.
"""

from __future__ import annotations

import errno
import json
import math
import os
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.errors import ObjectLost, StorageError
from webapp.files.atomic import storage_error, write_text
from webapp.files.object_storage.bucket import report_look_up
from webapp.files.part_file import sha256_of

STAYS_S = 300.0
"""Seconds after a request during which a file is not evicted."""

_FILL_TO = 0.9
"""Share of the limit down to which files are evicted."""

_LOOK_EVERY = 0.02
"""Share of the limit that a process adds before it measures the cache again: other processes add, too."""

_UNFINISHED_S = 3600.0
_COUNT_EVERY_S = 60.0
_LOCKS = 64
_NAME_BYTES = 120
_PROCESSES = Path("/proc")
_MAPS_COLUMNS = 5
"""Columns of a line of `/proc/*/maps` before the path, which may contain blanks."""


class ObjectCache:
    """A folder of cached objects that several processes share.

    Args:
        limit: Bytes; exceeded if more is requested within `stays_s`.
        stays_s: Seconds after a request during which a file is not evicted.
    """

    def __init__(self, folder: Path, *, limit: int, stays_s: float = STAYS_S) -> None:
        self.folder = folder
        self.limit = limit
        self._stays_s = stays_s
        self._added = limit  # so that the cache is measured on the first addition
        self._counting = threading.Lock()
        self._counted = -math.inf, 0
        self._locks = [threading.Lock() for _ in range(_LOCKS)]

    def path(self, pointer: Pointer, *, name: str, fetch: Callable[[Path], None]) -> Path:
        """Return the local copy of an object; fetch it if it is missing.

        Returns:
            Readable for at least `stays_s`.

        Raises:
            StorageError: The disk failed, or `fetch` did.
            ObjectLost: The content fetched differs from that stored.
        """
        place = self._place(pointer, name)
        if self._touch(place, pointer):
            report_look_up(found=True)
            return place
        with self._locks[hash(pointer.key) % _LOCKS]:
            found = self._touch(place, pointer)  # another thread may have fetched it meanwhile
            report_look_up(found=found)
            if not found:
                self._keep(place, pointer, make=fetch)
        return place

    @contextmanager
    def read_once(self, pointer: Pointer, *, name: str, fetch: Callable[[Path], None]) -> Iterator[Path]:
        """Yield the path of an object: its cached copy, or a temporary one that is deleted after the block.

        Reading many objects once thus evicts nothing that others request repeatedly. Parameters and errors
        are those of `path`.
        """
        place = self._place(pointer, name)
        if self._touch(place, pointer):
            yield place
            return
        temporary = self.folder / "once" / f".{secrets.token_hex(6)}.tmp"
        try:
            try:
                _make(temporary, pointer, name=place.name, make=fetch)
            except OSError as error:
                raise storage_error(error, where=str(self.folder)) from error
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)

    def adopt(self, file: Path, pointer: Pointer, *, name: str) -> None:
        """Copy a file that was just stored into the cache; if that fails, it is fetched on demand later."""
        place = self._place(pointer, name)
        with suppress(StorageError, OSError):
            self._keep(place, pointer, make=lambda target: _copy(file, target))

    def rename(self, pointer: Pointer, *, before: str, name: str) -> None:
        """Rename the copy of an object after its file; a missing one is fetched on demand later."""
        with suppress(OSError):
            self._place(pointer, before).rename(self._place(pointer, name))

    def size(self) -> int:
        """Sum the bytes of all copies."""
        return sum(size for _, size, _ in self._files())

    def recent_size(self) -> int:
        """Return `size`, at most a minute old: measuring all copies takes a while."""
        with self._counting:
            counted_at, size = self._counted
        if time.monotonic() >= counted_at + _COUNT_EVERY_S:
            size = self.size()
            with self._counting:
                self._counted = time.monotonic(), size
        return size

    def _place(self, pointer: Pointer, name: str) -> Path:
        flat = pointer.key.rpartition("/")[2]
        shown = name.encode()[-_NAME_BYTES:].decode("utf-8", "ignore")
        return self.folder / flat[:2] / f"{flat}-{shown}"

    def _touch(self, place: Path, pointer: Pointer) -> bool:
        """Record the request of a copy in its atime; False if there is none of the right size."""
        try:
            if place.stat().st_size != pointer.bytes:
                return False
            os.utime(place, ns=(time.time_ns(), pointer.mtime_ns))
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError as error:
            raise storage_error(error, where=str(place)) from error
        return True

    def _keep(self, place: Path, pointer: Pointer, *, make: Callable[[Path], None]) -> None:
        self._make_room(pointer.bytes)
        temporary = place.with_name(f".{secrets.token_hex(6)}.tmp")
        try:
            try:
                _make(temporary, pointer, name=place.name, make=make)
                temporary.replace(place)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as error:
            raise storage_error(error, where=str(self.folder)) from error

    def _make_room(self, size: int) -> None:
        """Evict the least recently requested files if the limit is exceeded; in one process at a time."""
        with self._counting:
            self._added += size
            if self._added < self.limit * _LOOK_EVERY:
                return
            self._added = size
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with FileLock(self.folder / "room.lock", timeout=0):
                self._evict(size)
        except Timeout:
            return  # another process is evicting
        except OSError as error:
            raise storage_error(error, where=str(self.folder)) from error

    def _evict(self, size: int) -> None:
        files = sorted(self._files())
        total = sum(one for _, one, _ in files) + size
        if total <= self.limit:
            return
        stays_from, mapped = time.time_ns() - int(self._stays_s * 1e9), mapped_names(self.folder)
        for asked, bytes_, path in files:
            if asked >= stays_from or total <= self.limit * _FILL_TO:
                return
            if path.name in mapped:
                continue
            with suppress(OSError):
                path.unlink(missing_ok=True)
            total -= bytes_

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        """List time of the last request, bytes and path of all copies; delete leftovers of killed writers."""
        for path in self.folder.glob("*/*"):
            try:
                found = path.stat()
            except FileNotFoundError:
                continue
            is_unfinished = path.name.startswith(".") and path.suffix == ".tmp"
            if is_unfinished and time.time() - found.st_mtime > _UNFINISHED_S:
                path.unlink(missing_ok=True)
                continue
            yield found.st_atime_ns, found.st_size, path


def _make(file: Path, pointer: Pointer, *, name: str, make: Callable[[Path], None]) -> None:
    """Write an object to a file, and check that its content is what was stored."""
    file.parent.mkdir(parents=True, exist_ok=True)
    make(file)
    if file.stat().st_size != pointer.bytes or sha256_of(file) != pointer.sha256:
        raise ObjectLost(
            "the object storage returned content other than what was stored",
            where=name,
            hint="restore the object from a backup",
        )
    os.utime(file, ns=(time.time_ns(), pointer.mtime_ns))


def _copy(source: Path, target: Path) -> None:
    """Copy a file; a hard link would share its times with the original."""
    shutil.copyfile(source, target)


def mapped_names(folder: Path) -> set[str]:
    """List the names of files below a folder that a process of this user has mapped.

    Returns:
        Without folders; empty if the system has no `/proc`, or it shows nothing.
    """
    inside, found = os.fsencode(f"{folder.resolve()}/"), set()
    for maps in _PROCESSES.glob("[0-9]*/maps"):
        with suppress(OSError):  # the process has ended, or is another user's
            for line in maps.read_bytes().splitlines():
                path = line.split(maxsplit=_MAPS_COLUMNS)[_MAPS_COLUMNS:]
                if path and path[0].startswith(inside):
                    found.add(os.fsdecode(path[0].rpartition(b"/")[2]))
    return found


SUFFIX = ".object"


@dataclass(frozen=True, slots=True)
class Pointer:
    """A stored file: its object, and its properties when it was stored."""

    key: str  # Of the object, below the prefix of the storage; unique for each upload
    sha256: str  # Of the content
    # `bytes`, `mtime_ns`: Size and modification time of the file.
    bytes: int
    mtime_ns: int


def pointer_path(path: Path) -> Path:
    """Return the path of a file's pointer: hidden, next to it, so that it moves with the map's folder."""
    return path.with_name(f".{path.name}{SUFFIX}")


def pointed_path(pointer: Path) -> Path:
    """Return the path of the file that a pointer replaces."""
    return pointer.with_name(pointer.name[1 : -len(SUFFIX)])


def read_pointer(path: Path) -> Pointer | None:
    place = pointer_path(path)
    try:
        return Pointer(**json.loads(place.read_bytes()))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return None  # no pointer of that name can exist in this file system
        raise StorageError(f"the file cannot be read: {error.strerror}", where=str(place)) from error
    except (ValueError, TypeError) as error:
        raise StorageError(
            "this pointer to an object is damaged", where=str(place), hint="copy it from a backup"
        ) from error


def write_pointer(path: Path, pointer: Pointer) -> None:
    """Write or replace the pointer of a file atomically. Raises StorageError."""
    write_text(pointer_path(path), json.dumps(asdict(pointer)))
