"""Photos that wait to be sent, each a file of its own: they are large, and poses do not wait for them.

`photos/00000007.json` tells of `photos/00000007.photo`. It is written last and deleted first: a photo
without it was never taken over, or has been sent.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

from webapp.robot.disk import sync_folder, told, write_whole

_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True)
class PhotoNote:
    """What is known of a photo.

    Attributes
    ----------
    name : str
        Of the file, for people.
    sha256 : str
        Hexadecimal.
    size : int
        Bytes.
    time : float
        Seconds since 1970, UTC.
    object : str or None
        The object it shows.
    """

    name: str
    sha256: str
    size: int
    time: float
    object: str | None


@dataclass(frozen=True, slots=True)
class WaitingPhoto:
    """A photo on the disk.

    Attributes
    ----------
    path : Path
    note : PhotoNote
    """

    path: Path
    note: PhotoNote

    @property
    def _note_path(self) -> Path:
        return self.path.with_suffix(".json")


class PhotoQueue:
    """Photos in the order in which they came.

    Parameters
    ----------
    folder : Path
        Is made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with told(folder):
            folder.mkdir(exist_ok=True)
            for path in folder.iterdir():
                if path.suffix == ".tmp" or (
                    path.suffix == ".photo" and not path.with_suffix(".json").exists()
                ):
                    path.unlink()  # a kill came in between
            self.damaged = _put_damaged_away(folder)
            """Names of photos whose notes could not be read; they are not sent."""
            self.size = sum(_read(note).size for note in waiting(folder))
            """Bytes of the photos that wait."""

    def add(self, source: BinaryIO, *, name: str, time: float, object_id: str | None) -> PhotoNote:
        """Take a photo over; when this returns, it survives a power cut.

        Raises
        ------
        DiskFull, StorageError
            It was not taken over.
        """
        numbers = [int(path.stem) for path in self._folder.glob("*.photo")]
        path = self._folder / f"{max(numbers, default=-1) + 1:08d}.photo"
        temporary = path.with_suffix(".tmp")
        try:
            with told(path):
                sha256, size = _copy(source, temporary)
                note = PhotoNote(name, sha256, size, time, object_id)
                temporary.replace(path)
                write_whole(path.with_suffix(".json"), json.dumps(asdict(note)).encode("utf-8"))
        finally:
            temporary.unlink(missing_ok=True)
        self.size += size
        return note

    def first(self) -> WaitingPhoto | None:
        """Give the photo that has waited longest."""
        notes = waiting(self._folder)
        return WaitingPhoto(notes[0].with_suffix(".photo"), _read(notes[0])) if notes else None

    def count(self) -> int:
        """Count the photos that wait."""
        return len(waiting(self._folder))

    def sent(self, photo: WaitingPhoto) -> None:
        """Delete a photo that the server has."""
        with told(photo.path):
            photo._note_path.unlink()
            photo.path.unlink()
        self.size -= photo.note.size

    def refused(self, photo: WaitingPhoto) -> Path:
        """Put a photo that the server does not want out of the way; tell where it is now."""
        aside = self._folder / "refused"
        target = aside / f"{photo.note.sha256[:16]}-{Path(photo.note.name).name}"
        with told(aside):
            aside.mkdir(exist_ok=True)
            shutil.copyfile(photo.path, target)
            sync_folder(aside)
        self.sent(photo)
        return target


def waiting(folder: Path) -> list[Path]:
    """List the notes of the photos that wait, longest waiting first."""
    return sorted(folder.glob("*.json"))


def _read(note: Path) -> PhotoNote:
    return PhotoNote(**json.loads(note.read_text("utf-8")))


def _put_damaged_away(folder: Path) -> list[str]:
    damaged = []
    for note in waiting(folder):
        photo = note.with_suffix(".photo")
        try:
            whole = photo.exists() and photo.stat().st_size == _read(note).size
        except (ValueError, TypeError):
            whole = False
        if not whole:
            damaged.append(note.rename(note.with_suffix(".damaged")).name)
    return damaged


def _copy(source: BinaryIO, target: Path) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    with target.open("wb") as file:
        while block := source.read(_BLOCK):
            digest.update(block)
            size += len(block)
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest(), size
