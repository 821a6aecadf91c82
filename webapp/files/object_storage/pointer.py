"""The small file that stands in the library's folder for a file whose content is an object."""

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
    """What a file was when it was stored.

    Attributes
    ----------
    key : str
        Of the object, below the prefix of the storage. No two uploads have the same.
    sha256 : str
        Of the content.
    bytes, mtime_ns : int
        Size and time of the file.
    """

    key: str
    sha256: str
    bytes: int
    mtime_ns: int


def pointer_path(path: Path) -> Path:
    """Name the pointer of a file: next to it, hidden, so that it moves with the folder of its map."""
    return path.with_name(f".{path.name}{SUFFIX}")


def pointed_path(pointer: Path) -> Path:
    """Name the file that a pointer stands for."""
    return pointer.with_name(pointer.name[1 : -len(SUFFIX)])


def read_pointer(path: Path) -> Pointer | None:
    """Read the pointer of a file; None where there is none.

    Raises
    ------
    StorageError
        It is damaged, or cannot be read.
    """
    place = pointer_path(path)
    try:
        return Pointer(**json.loads(place.read_bytes()))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return None  # the file system could not have held a pointer of that name
        raise StorageError(f"the file cannot be read: {error.strerror}", where=str(place)) from error
    except (ValueError, TypeError) as error:
        raise StorageError(
            "this pointer to an object is damaged", where=str(place), hint="copy it from a backup"
        ) from error


def write_pointer(path: Path, pointer: Pointer) -> None:
    """Write or replace the pointer of a file, whole or not at all.

    Raises
    ------
    StorageError
    """
    write_text(pointer_path(path), json.dumps(asdict(pointer)))
