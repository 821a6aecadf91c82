"""Checks that all acknowledged edits are in the API's answer, in the database and in `map.cfg`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import select

from webapp.core.geo.types import round_half_up
from webapp.files.maps.cfg import read_cfg
from webapp.store.library import open_library
from webapp.store.schema import MapRecord, Photo

Place = tuple[float | None, float | None, float | None]
"""x_px, y_px, heading_deg."""


@dataclass(frozen=True, slots=True)
class Final:
    """Content of a map's database rows and its `map.cfg` after the program has ended."""

    revision: int
    exported_revision: int
    rows: dict[int, Place]
    cfg: dict[int, tuple[int, int]]


def read_final(library_folder: Path, slug: str, *, url: str | None = None) -> Final:
    """Read database and `map.cfg` of a map; `url` is that of the database, unless it is SQLite."""
    library = open_library(library_folder, url=url)
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
        photos = session.scalars(select(Photo).where(Photo.map_id == record.id, ~Photo.removed))
        rows = {photo.id: (photo.x_px, photo.y_px, photo.heading_deg) for photo in photos}
        revisions = record.revision, record.exported_revision
    library.database.close()
    document = read_cfg(library.cfg(slug))
    cfg = {e.id: (int(e.position.x), int(e.position.y)) for e in document.map.experiences}
    return Final(*revisions, rows, cfg)


def check_revisions(answers: list[dict[str, Any]], *, first: int, last: int) -> list[str]:
    """Compare the acknowledged revisions with those of the map."""
    seen = Counter(answer["revision"] for answer in answers)
    missing = sorted(set(range(first + 1, last + 1)) - set(seen))
    twice = sorted(revision for revision, count in seen.items() if count > 1)
    beyond = sorted(set(seen) - set(range(first + 1, last + 1)))
    return [
        f"revisions {what}: {found[:10]} ({len(found)})"
        for what, found in (
            ("that nobody made", missing),
            ("given twice", twice),
            ("that the map has not", beyond),
        )
        if found
    ]


def check_seen(answers: list[dict[str, Any]]) -> list[str]:
    """Find edits that overwrote changes by another client, which the editing client had not seen."""
    changed: dict[int, list[int]] = {}
    for answer in answers:
        for photo in answer["photos"]:
            changed.setdefault(photo["id"], []).append(answer["revision"])
    return [
        f"photo {number}: revision {answer['revision']} overwrites {between} unseen"
        for answer in answers
        for number, known in answer["known"].items()
        if (between := [r for r in changed.get(number, []) if known < r < answer["revision"]])
    ]


def acknowledged(photos: list[dict[str, Any]], answers: list[dict[str, Any]]) -> dict[int, Place]:
    """Return the places after all acknowledged edits, replayed in the order of their revisions."""
    places = {photo["id"]: place(photo) for photo in photos}
    for answer in sorted(answers, key=lambda answer: int(answer["revision"])):
        places |= {photo["id"]: place(photo) for photo in answer["photos"]}
    return places


def place(photo: dict[str, Any]) -> Place:
    """Return the place of a photo in the API's format."""
    return photo["x_px"], photo["y_px"], photo["heading_deg"]


def differences(expected: dict[int, Place], *, served: list[dict[str, Any]], final: Final) -> list[str]:
    """Report where the API, the database or `map.cfg` differ from the acknowledged edits."""
    cfg = {
        number: (round_half_up(x), round_half_up(y))
        for number, (x, y, _) in expected.items()
        if x is not None and y is not None
    }
    problems = [
        f"{what} has {there.get(number)} for photo {number}, acknowledged was {want.get(number)}"
        for what, want, there in (
            ("the API", expected, {photo["id"]: place(photo) for photo in served}),
            ("the database", expected, final.rows),
            ("map.cfg", cfg, final.cfg),
        )
        for number in sorted({*want, *there})
        if want.get(number) != there.get(number)
    ]
    if final.exported_revision != final.revision:
        problems.append(f"map.cfg holds revision {final.exported_revision} of {final.revision}")
    return problems
