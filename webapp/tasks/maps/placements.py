"""Creates, replaces and deletes further placements of a library map, as edits that can be undone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.types import MapPixel, inside
from webapp.core.mapmodel.clusters import gather
from webapp.errors import NotFound, UsageError
from webapp.files.maps.map_json import check_placement_name
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, PlacedElsewhere

KIND = "placement"
"""Kind of the edit."""


def put_placement(
    library: Library,
    map_id: int,
    *,
    name: str,
    account_id: int,
    positions: Mapping[int, MapPixel] | None = None,
    clusters_px: float | None = None,
) -> int | None:
    """Create or replace a placement; return the revision of the edit, None if nothing changed.

    Args:
        positions: Positions by photo id; by default those of the map.
        clusters_px: Instead of `positions`: move photos within this radius of each other to their common
            centre.

    Raises:
        UsageError: The name collides with another file, a position is outside the image, or no photo is
            placed.
        NotFound: A photo is not placed on the map.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        refuse_taken_name(session, record, name)
        there = {
            photo.id: MapPixel(photo.x_px, photo.y_px)
            for photo in maps.photos(session, record)
            if not photo.removed and photo.x_px is not None and photo.y_px is not None
        }
        wanted = there if positions is None else positions
        if clusters_px is not None:
            wanted = _gathered(session, record, there, radius_px=clusters_px)
        if not wanted:
            raise UsageError("no photo is placed on the map yet", hint="place photos first")
        _check_moves(record, wanted, there)
        changes: dict[str, Mapping[str, Any] | None] = {
            f"placed/{name}/{id}": None for id in _placed(session, record, name) if id not in wanted
        }
        changes |= {f"placed/{name}/{id}": {"x_px": at.x, "y_px": at.y} for id, at in wanted.items()}
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
    return None if edit is None else edit.revision


def _gathered(
    session: Session, record: MapRecord, there: Mapping[int, MapPixel], *, radius_px: float
) -> dict[int, MapPixel]:
    """Gather the photos of each floor separately."""
    floor_of = {photo.id: photo.floor for photo in maps.photos_by_id(session, record, there).values()}
    wanted: dict[int, MapPixel] = {}
    for floor in sorted(set(floor_of.values())):
        on_floor = {id: at for id, at in there.items() if floor_of[id] == floor}
        wanted |= gather(on_floor, radius_px=radius_px)
    return wanted


def delete_placement(library: Library, map_id: int, *, name: str, account_id: int) -> int | None:
    """Delete a placement, but not its photos or their positions on the map; return the edit's revision."""
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        ids = _placed(session, record, name)
        if not ids:
            raise NotFound(f"the map has no placement {name[:80]!r}", hint="reload the page")
        changes = {f"placed/{name}/{id}": None for id in ids}
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
    return None if edit is None else edit.revision


def refuse_taken_name(session: Session, record: MapRecord, name: str) -> None:
    """Refuse a name whose file would collide with that of the map or another placement, ignoring case.

    Raises:
        MapError: The name is not valid.
        UsageError: The name collides.
    """
    check_placement_name(name)
    others = session.scalars(
        select(PlacedElsewhere.placement).where(PlacedElsewhere.map_id == record.id).distinct()
    )
    taken = {"map"} | {other.casefold() for other in others if other != name}
    if name.casefold() in taken:
        raise UsageError(
            f"a placement cannot have the name {name!r}: its file would replace another one",
            where="name",
            hint="choose another name",
        )


def _check_moves(record: MapRecord, wanted: Mapping[int, MapPixel], there: Mapping[int, MapPixel]) -> None:
    width, height = record.satellite_width or 0, record.satellite_height or 0
    for id, at in wanted.items():
        if id not in there:
            raise NotFound(f"the photo {id} is not placed on the map", where=f"positions.{id}")
        if not (math.isfinite(at.x) and inside(at, width=width, height=height)):
            raise UsageError(
                f"the position ({at.x:g}, {at.y:g}) is outside the image",
                where=f"positions.{id}",
                hint=f"x is from 0 to {width}, y from 0 to {height} pixels",
            )


def _placed(session: Session, record: MapRecord, name: str) -> list[int]:
    found = select(PlacedElsewhere.photo_id).where(
        PlacedElsewhere.map_id == record.id, PlacedElsewhere.placement == name
    )
    return list(session.scalars(found))
