"""Pointers: small files in the library's folder that replace files whose content is an object."""

from __future__ import annotations

import errno
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from webapp.errors import StorageError
from webapp.files.atomic import write_text

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
    """Read the pointer of a file; None if it has none.

    Raises:
        StorageError: The pointer is damaged, or cannot be read.
    """
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
