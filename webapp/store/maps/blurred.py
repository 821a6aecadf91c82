"""Blurred boxes of photos: those of a record, and those of a file on any map of the library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from webapp.core.boxes import BlurBox
from webapp.store.schema import BlurredFile, MapRecord, Photo

_MOST_PARAMETERS = 5000
_HAS_BOXES = text("photo.blurred IS NOT NULL")
"""The condition of the index, as text: a JSON column may also hold the JSON value null."""


def boxes_of(photo: Photo) -> list[BlurBox]:
    return [BlurBox(**box) for box in photo.blurred or ()]


def boxes_of_files(session: Session, hashes: Iterable[str]) -> dict[str, tuple[BlurBox, ...]]:
    """Return the boxes that are blurred in some files on any map, also one in the bin or deleted.

    Returns:
        By SHA-256, without repetitions; files without any are absent.
    """
    wanted = sorted(set(hashes))
    found: dict[str, dict[BlurBox, None]] = {}
    for start in range(0, len(wanted), _MOST_PARAMETERS):
        block = wanted[start : start + _MOST_PARAMETERS]
        rows = select(Photo.sha256, Photo.blurred).where(Photo.sha256.in_(block), _HAS_BOXES)
        kept = select(BlurredFile.sha256, BlurredFile.boxes).where(BlurredFile.sha256.in_(block))
        for sha256, boxes in (
            *session.execute(rows.order_by(Photo.map_id, Photo.id)),
            *session.execute(kept),
        ):
            found.setdefault(sha256, {}).update((BlurBox(**box), None) for box in boxes or ())
    return {sha256: tuple(boxes) for sha256, boxes in found.items() if boxes}


def blurred_elsewhere(session: Session, photos: Sequence[Photo]) -> set[int]:
    """Return the ids of those photos of a map in which more is blurred on another map."""
    found = boxes_of_files(session, (photo.sha256 for photo in photos))
    return {p.id for p in photos if not set(found.get(p.sha256, ())).issubset(boxes_of(p))}


def keep_boxes(session: Session, record: MapRecord) -> None:
    """Keep the boxes of a map's photos before it is deleted, for the same files elsewhere."""
    rows = session.scalars(select(Photo).where(Photo.map_id == record.id, _HAS_BOXES))
    blurred = {photo.sha256: boxes_of(photo) for photo in rows if photo.blurred}
    for sha256, boxes in blurred.items():
        kept = session.get(BlurredFile, sha256)
        before = [] if kept is None else [BlurBox(**box) for box in kept.boxes]
        both = [box._asdict() for box in dict.fromkeys((*before, *boxes))]
        session.merge(BlurredFile(sha256=sha256, boxes=both))


def release_boxes(session: Session, photo: Photo) -> None:
    """Forget the boxes kept from deleted maps, when those of a photo with that content are chosen."""
    kept = session.get(BlurredFile, photo.sha256)
    if kept is not None:
        session.delete(kept)


def take_over_boxes(session: Session, photo: Photo) -> None:
    """Move the boxes kept from deleted maps to a new photo with that content, where they can be changed."""
    kept = session.get(BlurredFile, photo.sha256)
    if kept is not None:
        photo.blurred = kept.boxes
        session.delete(kept)
