"""Edits of a map are applied, undone and redone, and conflicts between people and tabs are detected.

An edit is a list of changes, each with a target (`map`, `photo/3`, `placed/clusters/3`, `point/gate`,
`note/2`, `floor/1`) and the values of its fields before and after. Undo restores the values before, but only
if they have not been changed since. All users undo their own edits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, bindparam, func, or_, select, update
from sqlalchemy.orm import Session

from webapp.core.geo.floors import Floor, floors_problem
from webapp.core.geo.types import MapPixel, inside
from webapp.core.mapmodel.model import EDITED
from webapp.errors import Conflict, NotFound
from webapp.store.clock import now
from webapp.store.maps import maps
from webapp.store.schema import Account, Edit, MapRecord, Photo, PlacedElsewhere

Fields = dict[str, Any]

PHOTO_FIELDS = frozenset({"x_px", "y_px", "radius_px", "floor", "removed", "fov_deg", *EDITED})
"""The field of view changes with `panorama`."""

POINTS_KIND = "control-points"
"""Kind of an edit of control points."""

NOTES_KIND = "notes"
"""Kind of an edit of notes on spots of the map."""

FLOORS_KIND = "floors"
"""Kind of an edit of the list of floors."""

_LISTED = {"point": ("control_points", "name"), "note": ("notes", "id"), "floor": ("floors", "id")}
"""Targets that are items of a list in the record: the column of the list, and the key of its items."""

OUTSIDE_KIND = "outside"
"""Kind of an edit that takes over changes in the files of a map."""

_KINDS_OF_LISTED = (POINTS_KIND, NOTES_KIND, FLOORS_KIND, "satellite", "georeference", OUTSIDE_KIND)
"""Kinds of edits that can change these lists."""

MAP_FIELDS = frozenset({"satellite_path", "satellite_width", "satellite_height", "georeference"})


def _newest_done(columns: Any) -> Select[Any]:
    return _own(columns, "done").order_by(Edit.id.desc()).limit(1)


def _oldest_undone(columns: Any) -> Select[Any]:
    return _own(columns, "undone").order_by(Edit.id).limit(1)


def _own(columns: Any, state: str) -> Select[Any]:
    there = Edit.map_id == bindparam("map_id"), Edit.account_id == bindparam("account_id")
    return select(columns).where(*there, Edit.state == state)


_NEWEST_DONE, _OLDEST_UNDONE = _newest_done(Edit), _oldest_undone(Edit)
_NEXT_STEPS = select(Edit.state, Edit.kind, func.json_array_length(Edit.changes)).where(
    or_(
        Edit.id == _newest_done(Edit.id).scalar_subquery(),
        Edit.id == _oldest_undone(Edit.id).scalar_subquery(),
    )
)
_CLOSE_UNDONE = (  # a parameter of an UPDATE cannot have the name of a column
    update(Edit)
    .where(
        Edit.map_id == bindparam("of_map"), Edit.account_id == bindparam("of_account"), Edit.state == "undone"
    )
    .values(state="closed")
    .execution_options(synchronize_session=False)
)


@dataclass(frozen=True, slots=True)
class UndoResult:
    edit: Edit
    # Why it was not done: the same thing has been changed since. The edit is then closed, so that the next
    # undo takes the one before.
    clash: str | None


@dataclass(frozen=True, slots=True)
class NextStep:
    """The edit that an undo or redo would affect: its kind, and its number of changes."""

    kind: str
    count: int


def is_of_photo(target: str) -> bool:
    return target.startswith(("photo/", "placed/"))


def apply(
    session: Session,
    record: MapRecord,
    *,
    changes: Mapping[str, Mapping[str, Any] | None],
    kind: str,
    account_id: int | None,
    seen: int | None = None,
) -> Edit | None:
    """Change some fields of a map as one step that can be undone; None if nothing changes.

    Args:
        changes: New values of fields by target; None removes a position in another placement, a control
            point, a note or a floor. A photo's position without `radius_px` is exact.
        kind: A word for the edit: `place`, `move`, `turn`, `remove`, `satellite` ...
        account_id: Author of the edit.

    Raises:
        Conflict: Nothing was changed.
        NotFound: The map has no such photo.
    """
    rows = _Rows(session, record, changes)
    steps: list[dict[str, Any]] = []
    for target, after in changes.items():
        after = rows.with_radius(target, after)
        before = _value(rows, target=target, fields=after)
        if seen is not None and rows.revision(target) > seen:
            raise Conflict(_who_changed(rows, target=target), where=target)
        if before != after:
            steps.append(
                {"target": target, "before": before, "after": None if after is None else dict(after)}
            )
    if not steps:
        return None
    clash = without_floor(session, record, {step["target"]: step["after"] for step in steps})
    if clash:
        raise Conflict(clash, hint="reload the page")
    _close_undone(session, record, account_id)
    _next_revision(record)
    for step in steps:
        _set(rows, target=step["target"], fields=step["after"])
    edit = Edit(
        map_id=record.id,
        account_id=account_id,
        kind=kind,
        changes=steps,
        state="done",
        revision=record.revision,
    )
    session.add(edit)
    session.flush()
    return edit


def undo(session: Session, record: MapRecord, *, account_id: int) -> UndoResult | None:
    """Undo the account's last edit of the map; None if there is none."""
    return _undo_or_redo(session, record, newest_done(session, record, account_id=account_id), back=True)


def redo(session: Session, record: MapRecord, *, account_id: int) -> UndoResult | None:
    """Redo the account's last undone edit of the map; None if there is none."""
    return _undo_or_redo(session, record, oldest_undone(session, record, account_id=account_id), back=False)


def newest_done(session: Session, record: MapRecord, *, account_id: int) -> Edit | None:
    """Find the edit that `undo` would undo."""
    return session.scalars(_NEWEST_DONE, {"map_id": record.id, "account_id": account_id}).first()


def oldest_undone(session: Session, record: MapRecord, *, account_id: int) -> Edit | None:
    """Find the edit that `redo` would redo: undone edits are always the account's last ones."""
    return session.scalars(_OLDEST_UNDONE, {"map_id": record.id, "account_id": account_id}).first()


def next_steps(session: Session, record: MapRecord, *, account_id: int) -> dict[str, NextStep | None]:
    """Describe what `undo` and `redo` would affect, without loading the edits, which may name every photo."""
    rows = session.execute(_NEXT_STEPS, {"map_id": record.id, "account_id": account_id})
    steps = {state: NextStep(kind, count) for state, kind, count in rows}
    return {"undo": steps.get("done"), "redo": steps.get("undone")}


def _undo_or_redo(session: Session, record: MapRecord, edit: Edit | None, *, back: bool) -> UndoResult | None:
    if edit is None:
        return None
    now_there, wanted = ("after", "before") if back else ("before", "after")
    rows = _Rows(session, record, [change["target"] for change in edit.changes])
    for change in edit.changes:
        there = _value(rows, target=change["target"], fields=change[now_there] or change[wanted])
        if there != change[now_there]:
            edit.state = "closed"
            return UndoResult(edit, _who_changed(rows, target=change["target"]))
    image = next((c[wanted] for c in edit.changes if "satellite_path" in (c[wanted] or {})), None)
    if image is not None and (clash := placed_on_present_image(session, record, edit, image=image)):
        edit.state = "closed"
        return UndoResult(edit, clash)
    if clash := without_floor(session, record, {c["target"]: c[wanted] for c in edit.changes}):
        edit.state = "closed"
        return UndoResult(edit, clash)
    _next_revision(record)
    for change in edit.changes:
        _set(rows, target=change["target"], fields=change[wanted])
    edit.state = "undone" if back else "done"
    edit.revision = record.revision
    return UndoResult(edit, None)


def revision_of_listed(session: Session, record: MapRecord, target: str) -> int:
    """Return the last revision of a control point, a note or a floor, which have no row of their own."""
    of_map = (Edit.map_id == record.id, Edit.kind.in_(_KINDS_OF_LISTED))
    for edit in session.scalars(select(Edit).where(*of_map).order_by(Edit.revision.desc())):
        if any(change["target"] == target for change in edit.changes):
            return edit.revision
    return 0


def _next_revision(record: MapRecord) -> None:
    record.revision += 1
    record.changed_at = now()


def _close_undone(session: Session, record: MapRecord, account_id: int | None) -> None:
    """Close the undone edits of an account, so that they cannot be redone after a new edit.

    Edits that the session has already loaded keep their state there.
    """
    if account_id is not None:
        session.execute(_CLOSE_UNDONE, {"of_map": record.id, "of_account": account_id})


class _Rows:
    """The rows that an edit names, fetched in bulk: one by one, ten thousand photos take seconds."""

    def __init__(self, session: Session, record: MapRecord, targets: Iterable[str]) -> None:
        self.session = session
        self.record = record
        parts = [target.split("/") for target in targets if is_of_photo(target)]
        self._photos = maps.photos_by_id(session, record, {int(part[-1]) for part in parts})
        self._elsewhere: dict[tuple[str, int], PlacedElsewhere] = {}
        for placement in {part[1] for part in parts if part[0] == "placed"}:
            found = select(PlacedElsewhere).where(
                PlacedElsewhere.map_id == record.id, PlacedElsewhere.placement == placement
            )
            self._elsewhere |= {(placement, row.photo_id): row for row in session.scalars(found)}

    def photo(self, number: str) -> Photo:
        """Return a photo of the map. Raises NotFound."""
        photo = self._photos.get(int(number))
        if photo is None:
            raise NotFound(f"the map has no photo {number}", hint="reload the page")
        return photo

    def with_radius(self, target: str, fields: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
        """Reset the radius of a photo that gets a new position without one."""
        if fields is None or "x_px" not in fields or "radius_px" in fields or not target.startswith("photo/"):
            return fields
        known = self.photo(target.split("/")[1]).radius_px is not None
        return {**fields, "radius_px": None} if known else fields

    def elsewhere(self, placement: str, number: str) -> PlacedElsewhere | None:
        """Return the position of a photo in a further placement."""
        return self._elsewhere.get((placement, int(number)))

    def revision(self, target: str) -> int:
        if target == "map":
            return self.record.satellite_revision
        if target.split("/", 1)[0] in _LISTED:
            return revision_of_listed(self.session, self.record, target)
        return self.photo(target.rsplit("/", 1)[1]).revision


def _value(rows: _Rows, *, target: str, fields: Mapping[str, Any] | None) -> Fields | None:
    """Read the current values of the named fields; None for a missing placement position or list item."""
    match target.split("/"):
        case ["map"]:
            return {name: getattr(rows.record, name) for name in _known(fields, MAP_FIELDS)}
        case ["photo", number]:
            photo = rows.photo(number)
            return {name: getattr(photo, name) for name in _known(fields, PHOTO_FIELDS)}
        case ["placed", placement, number]:
            there = rows.elsewhere(placement, number)
            return None if there is None else {"x_px": there.x_px, "y_px": there.y_px}
        case [kind, key] if kind in _LISTED:
            column, by = _LISTED[kind]
            found = {str(item[by]): item for item in getattr(rows.record, column) or ()}
            return None if key not in found else {k: v for k, v in found[key].items() if k != by}
        case _:
            raise ValueError(f"unknown target: {target}")


def _known(fields: Mapping[str, Any] | None, known: frozenset[str]) -> list[str]:
    if fields is None or not known.issuperset(fields):
        raise ValueError(f"not among {sorted(known)}: {fields}")
    return list(fields)


def _set(rows: _Rows, *, target: str, fields: Fields | None) -> None:
    record = rows.record
    match target.split("/"):
        case ["map"]:
            _assign(record, fields)
            record.satellite_revision = record.revision
        case ["photo", number]:
            photo = rows.photo(number)
            before = photo.is_placed, photo.panorama
            _assign(photo, fields)
            photo.revision = record.revision
            if before != (photo.is_placed, photo.panorama):
                record.photos_revision = record.revision
        case [kind, key] if kind in _LISTED:
            column, by = _LISTED[kind]
            items = [item for item in getattr(record, column) or () if str(item[by]) != key]
            if fields is not None:
                items.append({by: int(key) if by == "id" else key, **fields})
            setattr(record, column, sorted(items, key=lambda item: item[by]) or None)
        case [_, placement, number]:
            there = rows.elsewhere(placement, number)
            photo = rows.photo(number)
            if fields is None:
                rows.session.delete(there)
            elif there is None:
                new = PlacedElsewhere(map_id=record.id, placement=placement, photo_id=photo.id, **fields)
                rows.session.add(new)
            else:
                _assign(there, fields)
            photo.revision = record.revision


def _assign(row: MapRecord | Photo | PlacedElsewhere, fields: Fields | None) -> None:
    for name, value in (fields or {}).items():
        setattr(row, name, value)


def _who_changed(rows: _Rows, *, target: str) -> str:
    """Return a sentence about who changed a target last."""
    found = (
        select(Account.name)
        .join(Edit, Edit.account_id == Account.id)
        .where(Edit.map_id == rows.record.id, Edit.revision == rows.revision(target))
    )
    who = rows.session.scalars(found.limit(1)).first() or "somebody"
    what = "the satellite image"
    if target.startswith("point/"):
        what = f"the control point {target.split('/', 1)[1]}"
    elif target.startswith("note/"):
        what = "the note"
    elif target.startswith("floor/"):
        what = "the floor"
    elif target != "map":
        what = f"the photo {rows.photo(target.rsplit('/', 1)[1]).name}"
    return f"{who} has changed {what} in the meantime"


def placed_on_present_image(
    session: Session, record: MapRecord, edit: Edit, *, image: Mapping[str, Any]
) -> str | None:
    """Return why an earlier image cannot be restored; None if it can.

    Others have placed photos on the present image since an edit set or removed it, or photos would lie
    outside the restored image.
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
