"""A backup: a zip of uncompressed files, and a manifest with their hashes, which is required.

It is written under a temporary name, and renamed after it has been read back and checked.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import os
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from filelock import FileLock, Timeout

from webapp.errors import Conflict, InputError
from webapp.files.atomic import storage_error, sync_folder
from webapp.progress import Progress

MANIFEST = "manifest.json"
FORMAT = "experience-map-backup"
VERSION = 1

_BLOCK = 1 << 20
_TIME = (1980, 1, 1, 0, 0, 0)
_MAX_MANIFEST = 1 << 30
_SMALL, _MAX_RATIO = 1_000_000, 50
"""A larger manifest is compressed less than this: hashes are random."""

_PART = r"(?!\.{1,2}(?:/|$))[^/\x00]+"
_NAME = re.compile(rf"{_PART}(?:/{_PART})*")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError, KeyError)
_HINT = "use another backup; nothing was changed"


@dataclass(frozen=True, slots=True)
class BackupFile:
    size_bytes: int
    sha256: str


Files = dict[str, BackupFile]
"""Files of a backup by name, with forward slashes."""


class Archive:
    """A backup that is being written.

    Attributes:
        scratch: A private temporary file for the writer, deleted at the end.
    """

    def __init__(self, file: zipfile.ZipFile, scratch: Path) -> None:
        self._file = file
        self.files: Files = {}
        self.scratch = scratch

    def add(self, name: str, source: Path) -> None:
        """Add a file, unless its name was added before: files of the same name never differ.

        Raises:
            FileNotFoundError: The file does not exist, or was deleted; nothing was added.
        """
        if name in self.files:
            return
        with source.open("rb") as opened:
            info = zipfile.ZipInfo.from_file(source, name, strict_timestamps=False)
            with self._file.open(info, "w", force_zip64=True) as target:
                self.files[name] = _copy(opened, target.write)

    def add_bytes(self, name: str, data: bytes) -> None:
        """Add a small file. Raises OSError."""
        self._file.writestr(zipfile.ZipInfo(name, _TIME), data)
        self.files[name] = BackupFile(len(data), hashlib.sha256(data).hexdigest())

    def keep(self, wanted: Callable[[str], bool]) -> None:
        """Keep only wanted files in the manifest; the bytes of others stay, but are never unpacked."""
        self.files = {name: kept for name, kept in self.files.items() if wanted(name)}


@contextmanager
def new_backup(target: Path, *, about: Mapping[str, Any], progress: Progress) -> Iterator[Archive]:
    """Write a backup; it gets its name when the block has ended without an error.

    Args:
        target: An existing backup is replaced once the new one is complete.
        about: JSON values for the manifest.

    Raises:
        StorageError, DiskFull: Writing failed; no partial file remains.
        Conflict: Another process is writing the same backup.
        InputError: The data read back differ from those written: the disk is damaged.
    """
    part, scratch, lock = (target.with_name(f".{target.name}.{kind}") for kind in ("part", "db", "lock"))
    try:
        with FileLock(lock, timeout=0):
            try:
                yield from _written(part, scratch, about)
                check(part, progress=progress)
                part.replace(target)
                sync_folder(target.parent)
            finally:
                for path in (part, scratch):
                    path.unlink(missing_ok=True)
                with suppress(PermissionError):  # Windows deletes it by itself
                    lock.unlink(missing_ok=True)
    except Timeout as error:
        raise Conflict("another process is writing this backup", where=str(target)) from error
    except OSError as error:
        raise storage_error(error, where=str(target)) from error


def _written(part: Path, scratch: Path, about: Mapping[str, Any]) -> Iterator[Archive]:
    """Write a zip that only the user may read, as it contains the accounts."""
    for path in (part, scratch):  # left by a killed process
        path.unlink(missing_ok=True)
        path.touch(mode=0o600, exist_ok=False)
    with part.open("r+b") as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as zipped:
            archive = Archive(zipped, scratch)
            yield archive
            files = {name: [kept.size_bytes, kept.sha256] for name, kept in archive.files.items()}
            manifest = {"format": FORMAT, "version": VERSION, **about, "files": files}
            zipped.writestr(
                zipfile.ZipInfo(MANIFEST, _TIME), json.dumps(manifest, indent=0), zipfile.ZIP_DEFLATED
            )
        file.flush()
        os.fsync(file.fileno())


def check(path: Path, *, progress: Progress) -> Files:
    """Read a backup and compare all files with its manifest."""
    return _read(path, progress, lambda _name: _discarding())


def unpack(path: Path, folder: Path, *, place: Callable[[str], Path], progress: Progress) -> Files:
    """Unpack a backup, comparing all files with its manifest.

    Args:
        folder: Contains all paths that `place` returns.
        place: Maps a file's name to its path; missing folders are created.

    Raises:
        InputError: The file is not a backup, or is damaged: discard the files unpacked so far.
        StorageError, DiskFull: Reading or writing failed.
    """

    @contextmanager
    def target(name: str) -> Iterator[Callable[[bytes], object]]:
        file = place(name)
        if not file.resolve().is_relative_to(folder.resolve()):
            raise InputError("a path in the backup points outside its folder", where=name)
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("xb") as opened:
            yield opened.write
            opened.flush()
            os.fsync(opened.fileno())

    return _read(path, progress, target)


def read_manifest(path: Path) -> dict[str, Any]:
    with _zip_errors(path), zipfile.ZipFile(path) as opened:
        return _manifest(opened)[0]


def _read(path: Path, progress: Progress, target: Callable[[str], Any]) -> Files:
    with _zip_errors(path), zipfile.ZipFile(path) as opened:
        files = _manifest(opened)[1]
        progress.size(len(files))
        for name, kept in files.items():
            progress.check()
            with opened.open(name) as source, target(name) as write:
                if _copy(source, write, kept.size_bytes) != kept:
                    raise InputError(
                        "the backup is damaged: a file in it has changed", where=name, hint=_HINT
                    )
            progress.advance()
    return files


def _manifest(opened: zipfile.ZipFile) -> tuple[dict[str, Any], Files]:
    about = opened.NameToInfo.get(MANIFEST)
    if about is None or about.file_size > min(_MAX_MANIFEST, _SMALL + _MAX_RATIO * about.compress_size):
        raise InputError("this is not a backup of a library", hint="expmap backup makes one")
    try:
        content = json.loads(opened.read(MANIFEST))
        if content["format"] != FORMAT or content["version"] != VERSION:
            raise InputError(
                "this backup was made by another version of the program", hint="update the program"
            )
        files = {
            str(name): BackupFile(int(size), str(sha256)) for name, (size, sha256) in content["files"].items()
        }
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError("the backup's manifest is damaged", where=MANIFEST, hint=_HINT) from error
    for name, kept in files.items():
        if not (_NAME.fullmatch(name) and _SHA256.fullmatch(kept.sha256)):
            raise InputError("the backup's manifest is damaged", where=name, hint=_HINT)
    return content, files


def _copy(source: IO[bytes], write: Callable[[bytes], object], most: int | None = None) -> BackupFile:
    """Copy a file, but no more of it than the first block beyond `most` bytes."""
    digest, size = hashlib.sha256(), 0
    while (most is None or size <= most) and (block := source.read(_BLOCK)):
        write(block)
        digest.update(block)
        size += len(block)
    return BackupFile(size, digest.hexdigest())


@contextmanager
def _discarding() -> Iterator[Callable[[bytes], object]]:
    yield len


@contextmanager
def _zip_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except _BROKEN as error:
        raise InputError(
            f"this is not a backup, or it is damaged: {error}", where=str(path), hint=_HINT
        ) from error
    except OSError as error:
        raise storage_error(error, where=str(path)) from error
