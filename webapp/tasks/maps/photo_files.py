"""Names and stores the files of a map's photos, and deletes the remains of interrupted uploads.

A photo keeps its original file name unless another photo of the map has it. Before a file is moved in, a note
is written, which is deleted once the record is committed: a file with a note but without a record was left by
an interrupted upload, not put there by a person.
"""

from __future__ import annotations

import re
import time
import unicodedata
from datetime import timedelta
from pathlib import Path, PurePosixPath

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.files.atomic import write_bytes
from webapp.files.contents import hash_of, is_there, put_in_place, remove
from webapp.files.listing import DERIVED, folded
from webapp.files.object_storage.cache import Pointer
from webapp.files.part_file import discard, move_in
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo

PHOTOS = "photos"
"""Folder of a map's photos."""

_INTAKE = "intake"
"""Folder of the notes in `derived`: each is named by the hash of a file and contains its path."""

_UNSAFE = re.compile(r'["*/:;<>?\\|]+')
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
"""Names that Windows reserves for devices."""

_SAME_ENDINGS = {"jpg": {"jpg", "jpeg", "jpe"}, "tif": {"tif", "tiff"}, "heic": {"heic", "heif"}}
_MOST_BYTES = 100
"""Maximum length of a name; a longer one is shortened and gets a hash of the content."""
_SHORT_STEM = 40
_HASH_DIGITS = (8, 16, 64)


def free_path(session: Session, record: MapRecord, *, folder: Path, row: Photo, suffix: str) -> str:
    """Choose the path of a photo: its original name, or one with its hash if that is taken.

    An existing file with the same content and without a record is reused.

    Args:
        row: Not yet part of the map; with its original name and its hash.
        suffix: Suffix of its format.

    Returns:
        Path relative to the folder.
    """
    stem, ending = _plain_name(row.name, suffix)
    whole = f"{stem}.{ending}"
    is_usable = len(whole.encode()) <= _MOST_BYTES and not _RESERVED.fullmatch(whole)
    names = [whole] if is_usable else []
    short = stem[:_SHORT_STEM].rstrip(" .-")
    names += [f"{short}-{row.sha256[:digits]}.{ending}" for digits in _HASH_DIGITS]
    paths = [f"{PHOTOS}/{name}" for name in names]
    free = (path for path in paths if _is_free(folder / path, row) and not _is_known(session, record, path))
    return next(free, paths[-1])


def keep(source: Path, *, folder: Path, row: Photo, stored: Pointer | None = None) -> None:
    """Move a file to its path, or delete it if the photo already has its file; see `forget_intake`.

    Raises DiskFull, StorageError.

    Args:
        stored: Pointer to the object with the file's content, if it was stored: then the pointer is written
            instead.
    """
    target = folder / row.path
    if is_there(target):
        if stored is not None and stored.sha256 == row.sha256 and not target.is_file():
            put_in_place(source, target, pointer=stored)  # the object of the old pointer may be lost
        else:
            source.unlink()
        return
    note = _note(folder, row.sha256)
    note.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(note, row.path.encode())
    if stored is None:
        move_in(source, target)
    else:
        put_in_place(source, target, pointer=stored)


def forget_intake(folder: Path, row: Photo) -> None:
    """Delete the note of a file whose record is committed."""
    discard(_note(folder, row.sha256))


def sweep_orphans(library: Library, map_id: int) -> int:
    """Delete files in the photo folder of a map that were left without a record by interrupted uploads.

    Files that a person has put there are not touched.

    Returns:
        Number of files deleted.
    """
    swept = 0
    with library.database.read() as session:
        slug = session.get_one(MapRecord, map_id).slug
    if not any((library.map_folder(slug) / DERIVED / _INTAKE).glob("*")):
        return 0
    with library.database.write() as session:  # excludes uploads, which move files in write sessions, too
        record = session.get_one(MapRecord, map_id, with_for_update=True)
        folder = library.map_folder(record.slug)
        known = set(session.scalars(select(Photo.path).where(Photo.map_id == map_id)))
        for note in sorted((folder / DERIVED / _INTAKE).glob("*")):
            path = note.read_text("utf-8", "replace")
            file = folder / path
            ours = path.startswith(f"{PHOTOS}/") and path not in known
            if ours and is_there(file) and hash_of(file) == note.name:
                remove(file)
                swept += 1
            discard(note)
    return swept


def _note(folder: Path, sha256: str) -> Path:
    return folder / DERIVED / _INTAKE / sha256


def _plain_name(name: str, suffix: str) -> tuple[str, str]:
    """Return stem and suffix of a photo's original name, without characters unsuitable for a `.cfg`."""
    last = PurePosixPath(name.replace("\\", "/")).name
    stem, _, ending = last.rpartition(".")
    if not stem:
        stem, ending = ending, ""
    if ending.lower() not in _SAME_ENDINGS.get(suffix, {suffix}):
        ending = suffix
    printable = (c for c in unicodedata.normalize("NFC", stem) if unicodedata.category(c)[0] != "C")
    return _UNSAFE.sub("-", "".join(printable)).strip(" .-") or "photo", ending


def _is_free(file: Path, row: Photo) -> bool:
    if is_there(file):
        return hash_of(file) == row.sha256
    return not file.exists()


def _is_known(session: Session, record: MapRecord, path: str) -> bool:
    paths = select(Photo.path).where(Photo.map_id == record.id)
    if path.isascii():
        paths = paths.where(func.lower(Photo.path) == path.lower())
    return any(folded(other) == folded(path) for other in session.scalars(paths))


def sweep_uploads(library: Library, *, settings: Settings) -> int:
    """Delete uploads that have not continued for `upload.keep_hours`; return their number."""
    keep = timedelta(hours=settings.upload.keep_hours)
    with library.database.read() as session:
        begun, known = maps.uploads_begun_before(session, now() - keep), maps.upload_ids(session)
    if not begun and not _unknown(library, keep, known=known):
        return 0
    with library.database.write() as session:
        for upload in maps.uploads_begun_before(session, now() - keep):
            if _older(library.uploads / f"{upload.id}.part", keep):
                maps.finish_upload(session, upload.id)
        gone = _unknown(library, keep, known=maps.upload_ids(session))
        for path in gone:
            discard(path)
    return len(gone)


def _unknown(library: Library, keep: timedelta, *, known: set[str]) -> list[Path]:
    """List old files that belong to no upload."""
    old = [p for p in library.uploads.iterdir() if p.suffix != ".lock" and _older(p, keep)]
    return [path for path in old if path.stem not in known]


def _older(path: Path, age: timedelta) -> bool:
    """Return whether a file is missing, or was last written longer ago than `age`."""
    try:
        return time.time() - path.stat().st_mtime > age.total_seconds()
    except FileNotFoundError:
        return True
