"""Reasons why an edit cannot be made, undone or redone: later changes depend on what it changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import Floor, floors_problem
from webapp.core.geo.types import MapPixel, inside
from webapp.store.schema import Account, Edit, MapRecord, Photo


def placed_on_present_image(
    session: Session, record: MapRecord, edit: Edit, *, image: Mapping[str, Any]
) -> str | None:
    """Return why an earlier image cannot be restored; None if it can.

    Others have placed photos on the present image since an edit set or removed it, or photos would lie
    outside the restored image.

    Args:
        edit: To be undone or redone, which brings another image back.
        image: Fields of that image.
    """
    later = (
        select(Edit, Account.name)
        .join(Account, Account.id == Edit.account_id)
        .where(Edit.map_id == record.id, Edit.revision > edit.revision, Edit.state == "done")
        .where(Edit.account_id.is_distinct_from(edit.account_id))
    )
    for other, name in session.execute(later):
        if any((change["after"] or {}).get("x_px") is not None for change in other.changes):
            return f"{name} has placed photos on the satellite image in the meantime"
    taken_along = {change["target"] for change in edit.changes}
    width, height = (image.get(f"satellite_{side}", 0) or -1 for side in ("width", "height"))
    placed = select(Photo).where(Photo.map_id == record.id, Photo.x_px.is_not(None))
    left = [photo for photo in session.scalars(placed) if f"photo/{photo.id}" not in taken_along]
    if all(inside(MapPixel(p.x_px or 0.0, p.y_px or 0.0), width=width, height=height) for p in left):
        return None
    return "photos were placed on the satellite image in the meantime"


def without_floor(
    session: Session, record: MapRecord, changes: Mapping[str, Mapping[str, Any] | None]
) -> str | None:
    """Return why changes would make the floors inconsistent, or leave something on a missing one; or None."""
    if any(target.startswith("floor/") for target in changes) and _floors_clash(record, changes):
        return "the floors have been changed in the meantime"
    floors = {f"floor/{floor['id']}" for floor in record.floors or ()} | {"floor/0"}
    gone = {target for target, fields in changes.items() if target in floors and fields is None}
    floors |= {target for target, fields in changes.items() if target.startswith("floor/") and fields}
    moved = {target: fields["floor"] for target, fields in changes.items() if fields and "floor" in fields}
    if any(f"floor/{floor}" not in floors - (gone - {"floor/0"}) for floor in moved.values()):
        return "the floor has been removed in the meantime"
    left = {int(target.split("/")[1]) for target in gone} - {0}
    there = select(Photo.id).where(Photo.map_id == record.id, Photo.floor.in_(left))
    if left and any(f"photo/{id}" not in moved for id in session.scalars(there)):
        return "photos were placed on the floor in the meantime"
    written = {f"note/{note['id']}" for note in record.notes or () if note.get("floor") in left}
    if written - changes.keys():
        return "notes were written on the floor in the meantime"
    return None


def _floors_clash(record: MapRecord, changes: Mapping[str, Mapping[str, Any] | None]) -> bool:
    """Return whether the floors would be inconsistent after the changes."""
    after: dict[str, Mapping[str, Any] | None] = {f"floor/{f['id']}": f for f in record.floors or ()}
    after |= {target: fields for target, fields in changes.items() if target.startswith("floor/")}
    left = [Floor(int(t.split("/")[1]), f["name"], f["level"]) for t, f in after.items() if f]
    return floors_problem(left) is not None
