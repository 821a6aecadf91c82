"""Aligns the image of a floor with the map by pairs of spots, and moves what is on the floor; as one edit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from webapp.core.geo.affine import Affine, affine_through, apply_affine, compose, is_affine
from webapp.core.geo.types import MapPixel, inside
from webapp.errors import UsageError
from webapp.files.maps.lists import note_fields
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import notes
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image
from webapp.tasks.satellite.apply import TRAY
from webapp.tasks.satellite.floors import FloorEdit, further_floor, with_floor, write_floors

MOST_PAIRS = 100


def align_floor(
    library: Library,
    map_id: int,
    *,
    id: int,
    pairs: Sequence[tuple[MapPixel, MapPixel]],
    account_id: int,
) -> FloorEdit:
    """Move the image of a floor over the map, and the photos and notes on the floor with it.

    Args:
        pairs: Current and wanted positions of spots. One pair gives a shift, two a similarity, three or more
            an affine transformation.

    Raises:
        UsageError: The floor has no image of its own, the spots do not determine the transformation, or
            photos or notes would leave the map.
        NotFound
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        floor = further_floor(record, id)
        if floor.image is None:
            raise UsageError("the floor has no image of its own", hint="give it one first")
        move = _fit(pairs)
        laid = compose(move, floor.image.map_from_image)
        if not is_affine(laid):
            raise UsageError("the spots do not determine the alignment", hint="choose spots far apart")
        image = needed_image(record, with_georeference=False)
        changes = _moved_photos(maps.photos(session, record), image, floor=id, move=move)
        changes |= _moved_notes(record, image, floor=id, move=move)
        moved = replace(floor, image=replace(floor.image, map_from_image=laid))
        revision = write_floors(change, with_floor(record, moved), account_id=account_id, changes=changes)
    return FloorEdit(id, revision)


def _moved_photos(
    photos: Sequence[Photo], image: MapImage, *, floor: int, move: Affine
) -> dict[str, Mapping[str, Any] | None]:
    """Return the changes that move the photos of a floor with its image."""
    a, _, _, d, _, _ = move
    turn_deg = math.degrees(math.atan2(d, a))
    changes: dict[str, Mapping[str, Any] | None] = {}
    for photo in photos:
        if photo.floor != floor or photo.x_px is None or photo.y_px is None:
            continue
        at = apply_affine(move, MapPixel(photo.x_px, photo.y_px))
        on_map = inside(at, width=image.width, height=image.height)
        if photo.removed and not on_map:
            changes[f"photo/{photo.id}"] = TRAY  # in case the removal is undone
            continue
        if not on_map:
            raise _leaves(photo.name)
        fields: dict[str, Any] = {"x_px": at.x, "y_px": at.y, "radius_px": photo.radius_px}
        if photo.heading_deg is not None:
            fields["heading_deg"] = (photo.heading_deg + turn_deg) % 360.0
        changes[f"photo/{photo.id}"] = fields
    return changes


def _moved_notes(
    record: MapRecord, image: MapImage, *, floor: int, move: Affine
) -> dict[str, Mapping[str, Any] | None]:
    """Return the changes that move the notes of a floor with its image."""
    changes: dict[str, Mapping[str, Any] | None] = {}
    for note in notes(record):
        if note.floor != floor or note.position is None:
            continue
        at = apply_affine(move, note.position)
        if not inside(at, width=image.width, height=image.height):
            raise _leaves(note.title)
        changes[f"note/{note.id}"] = note_fields(replace(note, position=at))
    return changes


def _leaves(name: str) -> UsageError:
    return UsageError(
        f"{name} would be moved off the map", hint="align the floor before photos and notes are placed on it"
    )


def _fit(pairs: Sequence[tuple[MapPixel, MapPixel]]) -> Affine:
    """Fit the simplest transformation to pairs of spots by least squares: shift, similarity, affine."""
    if not 0 < len(pairs) <= MOST_PAIRS:
        raise UsageError(f"give 1 to {MOST_PAIRS} pairs of spots", where="pairs")
    if len(pairs) == 1:
        (x, y), (to_x, to_y) = pairs[0]
        return (1.0, 0.0, to_x - x, 0.0, 1.0, to_y - y)
    before, after = (np.array([pair[side] for pair in pairs], np.float64) for side in (0, 1))
    if len(pairs) == 2:
        start, end = (complex(*before[1] - before[0]), complex(*after[1] - after[0]))
        if not start or not end:
            raise UsageError("two spots are the same", where="pairs", hint="choose spots far apart")
        turn = end / start
        shift = complex(*after[0]) - turn * complex(*before[0])
        return (turn.real, -turn.imag, shift.real, turn.imag, turn.real, shift.imag)
    found = affine_through(before, after)
    if found is None:
        raise UsageError("the spots are on one line", where="pairs", hint="choose spots all over the floor")
    return found
