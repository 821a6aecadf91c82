"""The database of a spool, and the disk space that is reserved for it.

SQLite in WAL mode: one process writes, others may read meanwhile. A commit survives a killed process; it
survives a power cut if it was `durable`, or after the next `sync`.

A full disk must not block acknowledgements, since only they let the spool shrink. Hence the reserve: a file
that is deleted when such a write does not fit, and recreated when there is space. It is larger than the
write-ahead log before a checkpoint plus the growth of the database in that checkpoint. While there is no
reserve, new records may only use free pages, which deleted records have left.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import Conflict, DiskFull, StorageError

FILE = "spool.sqlite3"
DAMAGED = "damaged"
"""Name of a file next to the database that marks it as damaged."""

RESERVE_BYTES = 4_000_000
_MARGIN_BYTES = 1_000_000
_RETRY_S = 0.5
_PAGE_BYTES = 1024  # small: each commit writes whole pages, a record has 150 bytes, and SD cards wear out
_CHECKPOINT_PAGES = 1000
_SPARE_PAGES = 20  # for inner B-tree pages, in addition to the data
_BUSY_S = 0.2

_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE, sqlite3.SQLITE_IOERR_SHMSIZE)  # 2nd: disk quota
_CORRUPT = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)

Statement = tuple[str, tuple[object, ...]]


class DatabaseDamaged(StorageError):
    """The file is not a database, or is inconsistent."""


class SpoolDatabase:
    """The database in a folder, opened by its only writer; any thread may use it.

    Raises DatabaseDamaged, DiskFull, StorageError.

    Args:
        folder: Created if missing, with the database in it.
        reserve: File that reserves disk space.
    """

    def __init__(self, folder: Path, *, reserve: Path) -> None:
        self.folder = folder
        self.guard = threading.RLock()
        """Hold it to make several reads or writes atomic among threads."""
        self._path = folder / FILE
        self._reserve = _Reserve(reserve)
        self._commits = self._synced = 0
        self._is_durable: bool | None = None
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        try:
            self._open()
        except DatabaseDamaged:
            raise
        except StorageError:
            if not self._reserve.release():
                raise
            self._open()
        self._reserve.make()

    @property
    def used_bytes(self) -> int:
        """Bytes of the pages in use, without free pages."""
        with self.guard:
            return (self._pragma("page_count") - self._pragma("freelist_count")) * self._pragma("page_size")

    def select(self, query: str, *values: object, tolerant: bool = False) -> list[tuple[Any, ...]]:
        """Run a query; a damaged database is marked, to be set aside at the next start, unless `tolerant`."""
        noting = contextlib.nullcontext() if tolerant else self._noting_damage()
        with self.guard, noting, storage_errors(self._path):
            return self._connection.execute(query, values).fetchall()

    def write(
        self, *statements: Statement, durable: bool = False, urgent: bool = False, size: int = 0
    ) -> int:
        """Run statements in one transaction.

        Args:
            *statements: SQL and its values.
            durable: Return only when these and all earlier commits survive a power cut.
            urgent: On a full disk, use up the reserve.
            size: Upper bound of the bytes added.

        Returns:
            Number of rows that the last statement changed.

        Raises:
            DiskFull, StorageError: Nothing was changed.
        """
        with self.guard:
            if not urgent:
                self.require_room(size)
            for make_room in (self._checkpoint, self._reserve.release)[: 1 + urgent]:
                try:
                    return self._commit(statements, durable=durable)
                except DiskFull:
                    make_room()
            self._checkpoint()
            return self._commit(statements, durable=durable)

    def require_room(self, size: int) -> None:
        """Check that a number of bytes can be added to the database without using the reserve.

        Raises DiskFull.
        """
        with self.guard:
            pages = _SPARE_PAGES + 2 * size // _PAGE_BYTES
            if not self._reserve.make() and self._pragma("freelist_count") < pages:
                raise _disk_full(self._path, "the remaining space is reserved for acknowledgements")

    def require_reserve(self) -> None:
        """Check that a file can be added next to the database without using the reserve. Raises DiskFull."""
        if not self.make_reserve():
            raise _disk_full(self._path, "the remaining space is reserved for acknowledgements")

    def make_reserve(self) -> bool:
        """Recreate the reserve if it was used up and there is space; return whether it exists."""
        with self.guard:
            return self._reserve.make()

    def sync(self) -> None:
        """Sync all commits to the disk. Others may commit meanwhile."""
        with self.guard:
            commits = self._commits
        if commits == self._synced:
            return
        # A checkpoint syncs what it copies, so everything not yet synced is in the log.
        with storage_errors(self._path), contextlib.suppress(FileNotFoundError):
            descriptor = os.open(f"{self._path}-wal", os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        self._synced = max(self._synced, commits)

    def close(self) -> None:
        """Sync everything to the disk, and close the file."""
        self.sync()
        with self.guard:
            self._connection.close()

    def _open(self) -> None:
        with storage_errors(self._path):
            self._connection = sqlite3.connect(
                self._path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False
            )
            try:
                self._connection.execute(f"PRAGMA page_size = {_PAGE_BYTES}")
                self._connection.execute("PRAGMA journal_mode = WAL")
                self._connection.execute(f"PRAGMA wal_autocheckpoint = {_CHECKPOINT_PAGES}")
                self._connection.execute("PRAGMA cell_size_check = ON")
                self._connection.execute("SELECT count(*) FROM sqlite_master")
            except sqlite3.Error:
                self._connection.close()
                raise

    def _commit(self, statements: tuple[Statement, ...], *, durable: bool) -> int:
        changed = 0
        with self._noting_damage(), storage_errors(self._path):
            if durable is not self._is_durable:
                self._connection.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
                self._is_durable = durable
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                for sql, values in statements:
                    changed = self._connection.execute(sql, values).rowcount
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
        self._commits += 1
        if durable:
            self._synced = self._commits
        return changed

    @contextmanager
    def _noting_damage(self) -> Iterator[None]:
        try:
            yield
        except DatabaseDamaged:
            with contextlib.suppress(OSError):
                (self.folder / DAMAGED).touch()
            raise

    def _checkpoint(self) -> None:
        """Copy the log into the database, so that the next commit overwrites the log from its start."""
        with contextlib.suppress(StorageError), storage_errors(self._path):
            self._connection.execute("PRAGMA wal_checkpoint(RESTART)").fetchall()

    def _pragma(self, name: str) -> int:
        with storage_errors(self._path):
            return int(self._connection.execute(f"PRAGMA {name}").fetchone()[0])


class _Reserve:
    """A file of `RESERVE_BYTES`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_held = path.exists() and path.stat().st_size == RESERVE_BYTES
        self._next_try = -float("inf")

    def make(self) -> bool:
        """Create the file if there is space; return whether it exists."""
        if self._is_held or time.monotonic() < self._next_try:
            return self._is_held
        try:
            if shutil.disk_usage(self._path.parent).free < RESERVE_BYTES + _MARGIN_BYTES:
                return False
            with self._path.open("wb") as file:
                file.write(bytes(RESERVE_BYTES))
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            # A quota, or another program took the space: wait, so that not every record writes 4 MB.
            self._next_try = time.monotonic() + _RETRY_S
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)
            return False
        self._is_held = True
        return True

    def release(self) -> bool:
        """Delete the file; return whether it existed."""
        was_held, self._is_held = self._is_held, False
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)
        return was_held


def open_for_reading(folder: Path) -> sqlite3.Connection:
    """Open the database in a folder while its writer may have it open.

    Raises DatabaseDamaged, StorageError.
    """
    path = folder / FILE
    with storage_errors(path):
        return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)


def read(connection: sqlite3.Connection, query: str, *values: object) -> list[tuple[Any, ...]]:
    """Run a query on a database opened for reading; return no rows if the table does not exist yet."""
    with storage_errors(Path(FILE)):
        try:
            return connection.execute(query, values).fetchall()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_ERROR:  # just created, without tables
                return []
            raise


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Convert errors of the operating system or SQLite about a file.

    Raises DatabaseDamaged, DiskFull, StorageError.
    """
    try:
        yield
    except (OSError, sqlite3.DatabaseError) as error:
        code = getattr(error, "sqlite_errorcode", 0)
        reason = getattr(error, "strerror", None) or str(error)
        if code in _FULL or getattr(error, "errno", 0) in (errno.ENOSPC, errno.EDQUOT):
            raise _disk_full(path, reason) from error
        if code & 0xFF in _CORRUPT:
            raise DatabaseDamaged(
                f"the database of the spool is damaged: {reason}",
                where=str(path),
                hint="start the client again: it sets the database aside and continues with what can be read",
            ) from error
        raise StorageError(
            f"the file cannot be used: {reason}",
            where=str(path),
            hint="choose a folder that you may write to",
        ) from error


def _disk_full(path: Path, reason: str) -> DiskFull:
    return DiskFull(
        f"the disk is full: {reason}", where=str(path), hint="free some space on the disk of the spool"
    )


class FolderLock:
    """Exclusive lock of a folder, between and within processes; released when the process ends.

    Raises:
        Conflict: The folder is locked already.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / "lock.sqlite3"  # SQLite's file locks are portable
        self._connection = sqlite3.connect(path, timeout=0, isolation_level=None, check_same_thread=False)
        try:
            with storage_errors(path):
                self._connection.execute("PRAGMA journal_mode = MEMORY")  # a journal file needs space
                self._connection.execute("BEGIN EXCLUSIVE")
        except StorageError as error:
            self._connection.close()
            if getattr(error.__cause__, "sqlite_errorcode", 0) & 0xFF != sqlite3.SQLITE_BUSY:
                raise
            raise Conflict(
                "another program is using this spool", where=str(folder), hint="wait until it has ended"
            ) from error

    def release(self) -> None:
        """Release the lock."""
        self._connection.close()
