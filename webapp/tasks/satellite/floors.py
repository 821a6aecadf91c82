"""Floors of a map: added, changed, aligned and removed, each as one edit of the library."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sqlalchemy import select

from webapp.core.geo.affine import Affine, affine_through, apply_affine, compose, is_affine
from webapp.core.geo.floors import (
    BASE_FLOOR,
    Floor,
    FloorImage,
    floor_name_problem,
    floors_problem,
    level_problem,
    stretched,
)
from webapp.core.geo.types import MapPixel, inside
from webapp.core.mapmodel.model import Experience, Map, Placement, UnplacedPhoto, facts_of
from webapp.errors import GeoreferenceError, NotFound, UsageError
from webapp.files.atomic import write_bytes
from webapp.files.maps.folder import read_map, write_map
from webapp.files.maps.lists import floor_fields, note_fields
from webapp.files.satellite.georeference_files import read_geotiff
from webapp.files.satellite.raster import keep_file, opened_raster, reduced
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import floors, notes
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image
from webapp.tasks.satellite.apply import TRAY
from webapp.tasks.satellite.display import PREVIEW_PX
from webapp.tasks.satellite.files import removed_if_refused
from webapp.tasks.satellite.upright import as_shown, upright_copy, upright_name


@dataclass(frozen=True, slots=True)
class FloorEdit:
    id: int  # Id of the floor
    revision: int | None  # Revision of the edit; None if nothing changed


@dataclass(frozen=True, slots=True)
class NewFloor:
    floor: Floor  # Without an image; its id is chosen when it is added
    base: Floor  # Floor that the map's own image shows; used if the map has no floors yet
    # Its image, in the library's uploads folder; it is deleted afterwards. Without one, the floor is shown on
    # the map's own image.
    file: Path | None = None


def add_floor(
    library: Library, map_id: int, *, new: NewFloor, account_id: int, settings: Settings
) -> FloorEdit:
    """Add a floor.

    Raises:
        UsageError: The map has no image, or the floor is not valid.
        PhotoError: The image cannot be used.
    """
    with (
        _kept_image(library, map_id, file=new.file, settings=settings) as image,
        library.changing(map_id) as change,
    ):
        there = list(floors(change.record)) or [replace(new.base, id=BASE_FLOOR)]
        floor = replace(new.floor, id=1 + max(one.id for one in there), image=image)
        return FloorEdit(floor.id, write_floors(change, [*there, floor], account_id=account_id))


def change_floor(
    library: Library, map_id: int, *, id: int, fields: Mapping[str, Any], account_id: int
) -> FloorEdit:
    """Change `name`, `level` or `height_m` of a floor. Raises UsageError, NotFound."""
    with library.changing(map_id) as change:
        changed = replace(found_floor(change.record, id), **fields)
        return FloorEdit(id, write_floors(change, with_floor(change.record, changed), account_id=account_id))


def set_floor_image(
    library: Library, map_id: int, *, id: int, file: Path, account_id: int, settings: Settings
) -> FloorEdit:
    """Replace the image of a floor; photos keep their positions on the map.

    Raises:
        UsageError: It is the floor of the map's own image.
    """
    with (
        _kept_image(library, map_id, file=file, settings=settings) as image,
        library.changing(map_id) as change,
    ):
        changed = replace(further_floor(change.record, id), image=image)
        return FloorEdit(id, write_floors(change, with_floor(change.record, changed), account_id=account_id))


def remove_floor(library: Library, map_id: int, *, id: int, to_tray: bool, account_id: int) -> FloorEdit:
    """Remove a floor; its notes move to the same positions on the floor of the map's own image.

    Args:
        to_tray: Move its photos to the tray; else a floor with photos is not removed.

    Raises:
        UsageError: There are photos on it, or the map's own image shows it.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        further_floor(record, id)
        left = [floor for floor in floors(record) if floor.id != id]
        own = (Photo.map_id == record.id, Photo.floor == id)
        changes: dict[str, Mapping[str, Any] | None] = {}
        standing = 0
        for photo in session.scalars(select(Photo).where(*own)):
            changes[f"photo/{photo.id}"] = TRAY
            standing += photo.is_placed
        if standing and not to_tray:
            raise photos_on_floor(standing)
        for note in notes(record):
            if note.floor == id:
                changes[f"note/{note.id}"] = note_fields(replace(note, floor=BASE_FLOOR))
        revision = write_floors(change, left if len(left) > 1 else [], account_id=account_id, changes=changes)
    return FloorEdit(id, revision)


def with_floor(record: MapRecord, changed: Floor) -> list[Floor]:
    return [changed if floor.id == changed.id else floor for floor in floors(record)]


def found_floor(record: MapRecord, id: int) -> Floor:
    """Find a floor of a map. Raises NotFound."""
    found = next((floor for floor in floors(record) if floor.id == id), None)
    if found is None:
        raise NotFound(f"the map has no floor {id}", hint="somebody may have removed it; reload the page")
    return found


def further_floor(record: MapRecord, id: int) -> Floor:
    """Find a floor other than that of the map's own image. Raises NotFound, UsageError."""
    found = found_floor(record, id)
    check_removable(id)
    return found


def check_removable(id: int) -> None:
    """Refuse the floor of the map's own image. Raises UsageError."""
    if id == BASE_FLOOR:
        raise UsageError(
            "the map's own image shows this floor", hint="change that on the Image page", where=f"floor/{id}"
        )


def photos_on_floor(count: int) -> UsageError:
    return UsageError(
        f"{count} photos are on this floor",
        hint="move them to another floor first, or put them into the tray (tray=1)",
    )


def write_floors(
    change: MapChange,
    wanted: Sequence[Floor],
    *,
    account_id: int,
    changes: Mapping[str, Mapping[str, Any] | None] | None = None,
) -> int | None:
    """Set the floors of a map, with other changes in the same edit; return its revision.

    Raises UsageError, Conflict.
    """
    session, record = change.session, change.record
    needed_image(record, with_georeference=False)
    check_floors(wanted)
    kept = {floor.id for floor in wanted}
    gone = {f"floor/{floor.id}": None for floor in floors(record) if floor.id not in kept}
    written = {f"floor/{floor.id}": floor_fields(floor) for floor in wanted}
    done = edits.apply(
        session,
        record,
        changes={**(changes or {}), **gone, **written},
        kind=edits.FLOORS_KIND,
        account_id=account_id,
    )
    return None if done is None else done.revision


def check_floors(wanted: Sequence[Floor]) -> None:
    """Refuse invalid floors. Raises UsageError."""
    for floor in wanted:
        for what, problem in (
            ("name", floor_name_problem(floor.name)),
            ("level", level_problem(floor.level)),
            ("height_m", None if math.isfinite(floor.height_m or 0.0) else "must be a finite number"),
        ):
            if problem:
                raise UsageError(f"the {what} of a floor {problem}", where=what)
    problem = floors_problem(wanted)
    if problem:
        raise UsageError(problem, where="level", hint="give each floor a level of its own")


@contextmanager
def _kept_image(
    library: Library, map_id: int, *, file: Path | None, settings: Settings
) -> Iterator[FloorImage | None]:
    """Store an image in the map's folder; delete it if the map refuses it."""
    if file is None:
        yield None
        return
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        folder, base = library.map_folder(record.slug), needed_image(record, with_georeference=False)
    with ExitStack() as cleanup:
        cleanup.callback(file.unlink, missing_ok=True)
        shown = as_shown(file, scratch=library.uploads, settings=settings)
        cleanup.callback(shown.unlink, missing_ok=True)
        with opened_raster(shown, limits=settings.satellite) as raster:
            width, height = raster.width, raster.height
            reduced(raster, PREVIEW_PX)  # reads the whole file: damage is found before the map changes
        laid = plan_transform(file, base, size=(width, height))
        name = keep_file(shown, folder)
    with removed_if_refused(library, map_id, name=name):
        yield FloorImage(name, width, height, laid)


def plan_transform(file: Path, base: MapImage, *, size: tuple[int, int]) -> Affine:
    """Align a new image with the map by the georeferences of both, else stretch it over the whole map."""
    return _by_georeference(file, base, size=size) or stretched(*size, over=(base.width, base.height))


def _by_georeference(file: Path, base: MapImage, *, size: tuple[int, int]) -> Affine | None:
    with file.open("rb") as opened:
        if base.georeference is None or opened.read(2) not in (b"II", b"MM"):
            return None
    try:
        own = read_geotiff(file).georeference
    except GeoreferenceError:  # the image is still usable
        return None
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]]])
    there = base.georeference.pixel_from_latlon(own.latlon_from_pixel(corners))
    return affine_through(corners, there)


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


def add_in_folder(cfg: Path, *, new: NewFloor, settings: Settings) -> None:
    """Add a floor; its image is copied next to the map, under its own name, upright.

    Raises MapError, UsageError, PhotoError, StorageError.
    """
    the_map = read_map(cfg)
    there = the_map.floors or (replace(new.base, id=BASE_FLOOR),)
    with TemporaryDirectory() as scratch:
        file = None if new.file is None else _shown(new.file, Path(scratch), settings=settings)
        image = None if file is None else _laid(file, the_map, settings=settings)
        floor = replace(new.floor, id=1 + max(one.id for one in there), image=image)
        check_floors((*there, floor))
        if file is not None:
            _copy(file, cfg.with_name(file.name))
    write_map(cfg, replace(the_map, floors=(*there, floor)))


def _shown(file: Path, scratch: Path, *, settings: Settings) -> Path:
    """Return the image as it is used: the file, or an upright copy in `scratch`, named after it."""
    copy = upright_copy(file, scratch=scratch, settings=settings)
    if copy is None:
        return file
    return copy.rename(scratch / upright_name(file.name, copy))


def remove_in_folder(cfg: Path, id: int, *, to_tray: bool) -> None:
    """Remove a floor; the file of its image is kept. Raises MapError, UsageError, StorageError.

    Args:
        to_tray: Move its photos to the tray; else a floor with photos is not removed.
    """
    the_map = read_map(cfg)
    check_removable(id)
    on_floor = [e for e in the_map.experiences if e.floor == id]
    if on_floor and not to_tray:
        raise photos_on_floor(len(on_floor))
    left = tuple(floor for floor in the_map.floors if floor.id != id)
    gone = {e.id for e in on_floor}
    write_map(
        cfg,
        replace(
            the_map,
            floors=left if len(left) > 1 else (),
            experiences=tuple(e for e in the_map.experiences if e.id not in gone),
            placements=tuple(_without(placement, gone) for placement in the_map.placements),
            unplaced=(*the_map.unplaced, *map(_in_tray, on_floor)),
        ),
    )


def _without(placement: Placement, ids: set[int]) -> Placement:
    left = {id: at for id, at in placement.positions.items() if id not in ids}
    return replace(placement, positions=left)


def _in_tray(e: Experience) -> UnplacedPhoto:
    return UnplacedPhoto(e.id, e.photo, **facts_of(e))


def _laid(file: Path, the_map: Map, *, settings: Settings) -> FloorImage:
    base = MapImage(the_map.satellite.width, the_map.satellite.height, the_map.georeference)
    with opened_raster(file, limits=settings.satellite) as raster:
        size = raster.width, raster.height
    return FloorImage(file.name, *size, plan_transform(file, base, size=size))


def _copy(file: Path, target: Path) -> None:
    if target.exists() and target.resolve() != file.resolve():
        raise UsageError(
            "a file with this name already exists next to the map", where=str(target), hint="rename the image"
        )
    if not target.exists():
        write_bytes(target, file.read_bytes())
