"""Deletes the remains of interrupted uploads."""

from __future__ import annotations

import time
from datetime import timedelta
from pathlib import Path

from webapp.files.part_file import discard
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.maps import uploads


def sweep_uploads(library: Library, *, settings: Settings) -> int:
    """Delete uploads that have not continued for `upload.keep_hours`.

    Returns:
        Number of files deleted.
    """
    keep = timedelta(hours=settings.upload.keep_hours)
    with library.database.read() as session:
        begun, known = uploads.begun_before(session, now() - keep), uploads.known_ids(session)
    if not begun and not _unknown(library, keep, known=known):
        return 0
    with library.database.write() as session:
        for upload in uploads.begun_before(session, now() - keep):
            if _older(library.uploads / f"{upload.id}.part", keep):
                uploads.finish(session, upload.id)
        gone = _unknown(library, keep, known=uploads.known_ids(session))
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
