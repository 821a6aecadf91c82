"""Handles a `map.cfg` that was edited outside the library: compares it, and applies or overwrites it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel, whole_pixel
from webapp.core.mapmodel.model import WRITTEN, Experience, Map, MapPhoto
from webapp.errors import Conflict, MapError, NotFound, UsageError
from webapp.files.maps.folder import read_map
from webapp.files.maps.lists import floor_fields, note_fields, point_fields
from webapp.files.maps.map_json import georeference_fields
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere
from webapp.tasks.maps import export
from webapp.tasks.maps.adopt_map import PhotoFiles, add_removed, check_room_for_ids, distinct_hash
from webapp.tasks.maps.export import changed_outside, file_sha256
from webapp.tasks.maps.library_map import control_points, floors, notes
from webapp.tasks.relative_paths import relative_text, show_relative_to

Change = Mapping[str, Any] | None

_TAKEN_OVER = ("heading_deg", *WRITTEN)
"""Facts of photos that are taken over from the files."""

_Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class TakeOverResult:
    revision: int | None  # Revision of the edit; None if the file differs in form only
    left_out: tuple[str, ...]  # Messages about photos that could not be read


def show(library: Library, map_id: int, *, settings: Settings) -> dict[str, Any] | None:
    """Compare the file with the records.

    Args:
        settings: Only the limits of photos are used.

    Returns:
        None if the file was not edited. Else `sha256` of the file; `problem`, a message if it cannot be
            applied; `moved`, `turned`, `added`, `removed`, `kept`, lists of photos; `left_out`, messages;
            `placements`, `control_points` and `floors`, names; `notes`, titles; `georeference`, whether it
            changes.
    """
    with library.database.read() as session:
        record = _record(session.get(MapRecord, map_id))
        cfg = library.cfg(record.slug)
        if not changed_outside(record, cfg):
            return None
        sha256 = file_sha256(cfg)
        try:
            found = plan(session, record, cfg, files=PhotoFiles(cfg, settings.photo))
        except (MapError, UsageError) as error:
            return {
                "sha256": sha256,
                "problem": relative_text(str(error), cfg.parent),
                **_plan_json(TakeOverPlan()),
            }
    return {"sha256": sha256, "problem": None, **_plan_json(found)}


def take(
    library: Library, map_id: int, *, account_id: int, settings: Settings, sha256: str
) -> TakeOverResult:
    """Apply the file to the records, as one edit that can be undone.

    Args:
        sha256: Hash of the file that was shown.

    Raises:
        MapError, UsageError: The file cannot be applied.
        Conflict: The file has changed since it was shown, or was not edited.
        StorageError: The disk failed; changes that were applied are safe.
    """
    with library.database.read() as session:
        record = _record(session.get(MapRecord, map_id))
        cfg = library.cfg(record.slug)
        files = PhotoFiles(cfg, settings.photo)
        _check_same(record, cfg, sha256=sha256)
        with show_relative_to(cfg.parent):
            plan(session, record, cfg, files=files)  # reads the photos before the write lock is taken
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        _check_same(record, cfg, sha256=sha256)
        with show_relative_to(cfg.parent):
            found = plan(session, record, cfg, files=files)
        add_removed(session, record, found.new)
        by_id = {photo.id: photo for photo in record.photos}
        for id, path in found.renamed.items():
            by_id[id].path = path
        edit = edits.apply(
            session, record, changes=found.changes, kind=edits.OUTSIDE_KIND, account_id=account_id
        )
        record.exported_sha256 = sha256
        if found.renamed:
            record.photos_revision = record.revision
    return TakeOverResult(None if edit is None else edit.revision, tuple(found.left_out))


def discard(library: Library, map_id: int, *, sha256: str) -> None:
    """Overwrite the file from the records.

    Raises:
        Conflict: The file has changed since it was shown.
    """
    with library.database.read() as session:
        cfg = library.cfg(_record(session.get(MapRecord, map_id)).slug)
    if file_sha256(cfg) != sha256:
        raise Conflict("the file has changed since it was shown", hint="reload and compare again")
    export.export_map(library, map_id, overwrite=True)


def _check_same(record: MapRecord, cfg: Path, *, sha256: str) -> None:
    if not changed_outside(record, cfg) or file_sha256(cfg) != sha256:
        raise Conflict("the file has changed since it was shown", hint="reload and compare again")


def _record(found: MapRecord | None) -> MapRecord:
    if found is None:
        raise NotFound("map not found")
    return found


def _plan_json(found: TakeOverPlan) -> dict[str, Any]:
    inner = ("changes", "new", "renamed")
    return {part.name: getattr(found, part.name) for part in fields(found) if part.name not in inner}


@dataclass(slots=True)
class TakeOverPlan:
    """Changes that bring the records into agreement with the file."""

    changes: dict[str, Change] = field(default_factory=dict)  # Changes for `store.maps.edits.apply`
    # Records to add first, marked as removed and without a position; `changes` restores and places them.
    new: list[Photo] = field(default_factory=list)
    renamed: dict[int, str] = field(default_factory=dict)  # New paths of photos whose files were renamed
    # `moved`, `turned`, `added`, `removed`, `kept`: For display: photos with `id` and `name`; `kept` ones
    # were changed in the library since the file was written, and keep the library's state.
    moved: list[dict[str, Any]] = field(default_factory=list)
    turned: list[dict[str, Any]] = field(default_factory=list)
    added: list[dict[str, Any]] = field(default_factory=list)
    removed: list[dict[str, Any]] = field(default_factory=list)
    kept: list[dict[str, Any]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  # Messages about photos of the file that cannot be read
    placements: list[str] = field(default_factory=list)  # Names of further placements that change
    control_points: list[str] = field(default_factory=list)  # Names of control points that change
    # Titles of notes that change; for the note of a photo, the photo's name.
    notes: list[str] = field(default_factory=list)
    floors: list[str] = field(default_factory=list)  # Names of floors that change
    georeference: bool = False  # Whether it changes


def plan(session: Session, record: MapRecord, cfg: Path, *, files: PhotoFiles) -> TakeOverPlan:
    """Compare the file with the records.

    Raises:
        MapError: The file cannot be read as a map.
        UsageError: It refers to another satellite image.
    """
    map_ = read_map(cfg)
    check_room_for_ids(map_, cfg)
    image = map_.satellite
    there = (record.satellite_path, record.satellite_width, record.satellite_height)
    if there != (image.path, image.width, image.height):
        raise UsageError(
            f"the changed file has another satellite image: {image.path}, {image.width} x {image.height}",
            hint="import its folder as a new map, or export the file again from the library",
        )
    rows = maps.photos(session, record)
    made = _Planner(record, files, rows=rows)
    made.take_floors(session, map_)
    ids = made.take_photos(map_.experiences)
    made.take_placements(session, map_, ids)
    made.take_listed(session, map_, ids)
    georeference = georeference_fields(map_.georeference)
    if georeference != record.georeference and record.satellite_revision <= record.exported_revision:
        made.plan.changes["map"] = {"georeference": georeference}
        made.plan.georeference = True
    return made.plan


class _Planner:
    """Builds a plan photo by photo."""

    def __init__(self, record: MapRecord, files: PhotoFiles, *, rows: Iterable[Photo]) -> None:
        self.plan = TakeOverPlan()
        self._record, self._files = record, files
        self._rows = {row.id: row for row in rows}
        self._by_content = {row.sha256: row for row in self._rows.values()}
        self._new_contents: set[str] = set()
        self._next_id = record.next_id
        self._floors: set[int] = set()

    def take_photos(self, experiences: Iterable[Experience]) -> dict[int, int]:
        """Plan all photos; return the id in the records for each id in the file."""
        found, rest = self._matched(list(experiences))
        for e, row in found:
            self._changed(e, row)
        ids = {e.id: row.id for e, row in found}
        taken = set(ids.values())
        for e in rest:
            id = self._new(e, taken=taken)
            if id is not None:
                ids[e.id] = id
                taken.add(id)
        for row in self._rows.values():
            gone = row.id not in taken and row.x_px is not None and not row.removed
            if gone and self._ours_is_newer(row):
                self.plan.kept.append(_named(row))
            elif gone:
                self.plan.removed.append(_named(row))
                self.plan.changes[f"photo/{row.id}"] = {"removed": True}
        return ids

    def take_floors(self, session: Session, map_: Map) -> None:
        """Plan the floors; those missing from the file are kept."""
        changed = _changed_floors(session, self._record, map_)
        self.plan.changes |= changed
        self.plan.floors += [fields["name"] for fields in changed.values()]
        there = {floor["id"] for floor in self._record.floors or ()}
        known = {BASE_FLOOR, *there, *(floor.id for floor in map_.floors)}
        self._floors = known if map_.floors else set()

    def take_placements(self, session: Session, map_: Map, ids: Mapping[int, int]) -> None:
        there = session.scalars(select(PlacedElsewhere).where(PlacedElsewhere.map_id == self._record.id))
        before = {(row.placement, row.photo_id): (row.x_px, row.y_px) for row in there}
        after = {
            (p.name, ids[id]): (at.x, at.y)
            for p in map_.placements
            for id, at in p.positions.items()
            if id in ids
        }
        shown = set(ids.values())
        for key in sorted(before.keys() | after.keys()):
            name, id = key
            row = self._rows.get(id)
            if before.get(key) == after.get(key) or id not in shown or (row and self._ours_is_newer(row)):
                continue
            at = after.get(key)
            self.plan.changes[f"placed/{name}/{id}"] = None if at is None else {"x_px": at[0], "y_px": at[1]}
            if name not in self.plan.placements:
                self.plan.placements.append(name)

    def take_listed(self, session: Session, map_: Map, ids: Mapping[int, int]) -> None:
        """Plan control points and notes (except those of placed photos); keep those missing in the file."""
        placed = set(ids.values())
        in_tray = {p.id: p for p in map_.unplaced if p.id in self._rows and p.id not in placed}
        # Removed photos have no line, but points and notes still refer to them.
        known = {id: id for id in self._rows.keys() - placed} | dict(ids)
        points = _changed_points(session, self._record, map_, known=known)
        notes = _changed_notes(session, self._record, map_, known=known)
        self.plan.changes |= points | notes
        self.plan.control_points += [target.removeprefix("point/") for target in points]
        self.plan.notes += [fields["title"] for fields in notes.values()]
        for id, photo in in_tray.items():
            row = self._rows[id]
            differs = _other_facts(photo, row, WRITTEN)
            if differs and not self._ours_is_newer(row):
                self.plan.changes[f"photo/{id}"] = differs
                self.plan.notes.append(row.name)

    def _matched(
        self, experiences: list[Experience]
    ) -> tuple[list[tuple[Experience, Photo]], list[Experience]]:
        """Find the record of each line by id and path, or else by path alone."""
        found, rest = [], []
        for e in experiences:
            row = self._rows.get(e.id)
            if row is not None and row.path == e.photo:
                found.append((e, row))
            else:
                rest.append(e)
        taken = {row.id for _, row in found}
        by_path = {row.path: row for row in self._rows.values() if row.id not in taken}
        unknown = []
        for e in rest:
            row = by_path.pop(e.photo, None)
            if row is None:
                unknown.append(e)
            else:
                found.append((e, row))
        return found, unknown

    def _ours_is_newer(self, row: Photo) -> bool:
        return row.revision > self._record.exported_revision

    def _changed(self, e: Experience, row: Photo) -> None:
        differs = _differences(e, row)
        if e.floor in self._floors and e.floor != row.floor:
            differs["floor"] = e.floor
        if not differs:
            return
        if self._ours_is_newer(row):
            self.plan.kept.append(_named(row))
            return
        self.plan.changes[f"photo/{row.id}"] = differs
        if WRITTEN.keys() & differs:
            self.plan.notes.append(row.name)
        if row.removed or row.x_px is None:
            self.plan.added.append(_named(row))
        elif "x_px" in differs or "floor" in differs:
            move = {"from": [row.x_px, row.y_px], "to": [e.position.x, e.position.y]}
            self.plan.moved.append({**_named(row), **move})
        elif "heading_deg" in differs:
            self.plan.turned.append(_named(row))

    def _new(self, e: Experience, *, taken: set[int]) -> int | None:
        """Plan a line whose photo has no record; return its id, or None if it is left out."""
        row, problem = self._files.row(e)
        if problem is not None:
            self.plan.left_out.append(problem)
            return None
        same = self._by_content.get(row.sha256)
        if same is not None and same.id not in taken and same.id not in self.plan.renamed:
            self.plan.renamed[same.id] = e.photo
            # map.json identifies photos by path, and so has no entry for the renamed one
            self._changed(replace(e, floor=same.floor) if e.floor == BASE_FLOOR else e, same)
            return same.id
        row.id = max(e.id, self._next_id)
        self._next_id = row.id + 1
        if same is not None or row.sha256 in self._new_contents:
            row.sha256 = distinct_hash(row.sha256, row.id)
        self._new_contents.add(row.sha256)
        place = {name: getattr(row, name) for name in ("x_px", "y_px", "radius_px", *_TAKEN_OVER)}
        wanted = {**place, "removed": False, **({"floor": e.floor} if e.floor != BASE_FLOOR else {})}
        for name in place:
            setattr(row, name, None)
        row.floor = BASE_FLOOR
        row.removed = True
        self.plan.new.append(row)
        self.plan.changes[f"photo/{row.id}"] = wanted
        self.plan.added.append(_named(row))
        return row.id


def _named(row: Photo) -> dict[str, Any]:
    return {"id": row.id, "name": row.name}


def _differences(e: Experience, row: Photo) -> dict[str, Any]:
    """Return the fields that differ in the file; fields without a value there do not differ."""
    differs: dict[str, Any] = {"removed": False} if row.removed else {}
    at = None if row.x_px is None or row.y_px is None else MapPixel(row.x_px, row.y_px)
    if at is None or whole_pixel(at) != whole_pixel(e.position):
        differs |= {"x_px": e.position.x, "y_px": e.position.y, "radius_px": e.radius_px}
    return differs | _other_facts(e, row, _TAKEN_OVER)


def _other_facts(photo: MapPhoto, row: Photo, names: Iterable[str]) -> dict[str, Any]:
    there = {name: getattr(photo, name) for name in names}
    return {name: value for name, value in there.items() if value not in (None, getattr(row, name))}


def _changed_points(
    session: Session, record: MapRecord, map_: Map, *, known: Mapping[int, int]
) -> dict[str, _Fields]:
    """Return the control points that change, by target of an edit; those missing in the file are kept.

    Args:
        known: Id in the records for each photo id that may occur in the file, including removed photos.
    """
    after = {}
    for point in map_.control_points:
        clicks = [c._replace(photo=known[c.photo]) for c in point.clicks if c.photo in known]
        after[f"point/{point.name}"] = point_fields(replace(point, clicks=tuple(sorted(clicks))))
    before = {f"point/{point.name}": point_fields(point) for point in control_points(record)}
    return _changed(session, record, before=before, after=after)


def _changed_notes(
    session: Session, record: MapRecord, map_: Map, *, known: Mapping[int, int]
) -> dict[str, _Fields]:
    """Return the notes at spots that change; see `changed_points`.

    If the file has no floors, existing notes stay on theirs.
    """
    there = {note.id: note for note in notes(record)}
    after = {}
    for note in map_.notes:
        photos = tuple(known[id] for id in note.photos if id in known)
        floor = there[note.id].floor if not map_.floors and note.id in there else note.floor
        after[f"note/{note.id}"] = note_fields(replace(note, photos=photos, floor=floor))
    before = {f"note/{id}": note_fields(note) for id, note in there.items()}
    return _changed(session, record, before=before, after=after)


def _changed_floors(session: Session, record: MapRecord, map_: Map) -> dict[str, _Fields]:
    """Return the floors that change; see `changed_points`."""
    after = {f"floor/{floor.id}": floor_fields(floor) for floor in map_.floors}
    before = {f"floor/{floor.id}": floor_fields(floor) for floor in floors(record)}
    return _changed(session, record, before=before, after=after)


def _changed(
    session: Session, record: MapRecord, *, before: Mapping[str, _Fields], after: Mapping[str, _Fields]
) -> dict[str, _Fields]:
    """Leave out equal ones, and those changed in the library since the file was written."""
    return {
        target: fields
        for target, fields in after.items()
        if fields != before.get(target)
        and edits.revision_of_listed(session, record, target) <= record.exported_revision
    }
