"""Checks that every photo of a folder is in a map once, undamaged, and at the position of its `.cfg`."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path

from sqlalchemy import select

from webapp.core.mapmodel.model import Experience
from webapp.files.maps.cfg import read_cfg
from webapp.store.library import open_library
from webapp.store.schema import MapRecord, Photo


def problems_of(source: Path, there: Path, *, exported: bytes) -> list[str]:
    """Compare a map of a library with the `.cfg` that it was made from.

    Args:
        source: The `.cfg` with the photos that were uploaded.
        there: `map.cfg` in the library.
        exported: The `.cfg` downloaded from the page.
    """
    wanted = {_sha256(source.parent / e.photo): _xy(e) for e in read_cfg(source).map.experiences}
    placed = {_sha256(there.parent / e.photo): _xy(e) for e in read_cfg(there).map.experiences}
    rows = Counter(_rows(there))
    problems = [] if exported == there.read_bytes() else ["the .cfg that was taken away is another one"]
    problems += [f"photo {sha[:12]} is missing" for sha in wanted if not rows[sha]]
    problems += [f"photo {sha[:12]} is there {count} times" for sha, count in rows.items() if count > 1]
    problems += [f"photo {sha[:12]} comes from nowhere" for sha in rows if sha not in wanted]
    problems += [
        f"photo {sha[:12]} is at {placed.get(sha)} instead of {xy}"
        for sha, xy in wanted.items()
        if placed.get(sha) != xy
    ]
    return problems


def _rows(cfg: Path) -> list[str]:
    """Return the hashes of the photos in the database, after checking their files."""
    library = open_library(cfg.parents[1])
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == cfg.parent.name)).one()
        photos = list(session.scalars(select(Photo).where(Photo.map_id == record.id, ~Photo.removed)))
    library.database.close()
    for photo in photos:
        assert _sha256(cfg.parent / photo.path) == photo.sha256, f"{photo.path} is damaged"
    return [photo.sha256 for photo in photos]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _xy(experience: Experience) -> tuple[int, int]:
    return int(experience.position.x), int(experience.position.y)
