"""Changes the floors of a map outside a library, in its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from webapp.core.geo.floors import BASE_FLOOR, FloorImage
from webapp.core.mapmodel.model import Experience, Map, Placement, UnplacedPhoto, facts_of
from webapp.errors import UsageError
from webapp.files.atomic import write_bytes
from webapp.files.maps.folder import read_map, write_map
from webapp.files.satellite.raster import opened_raster
from webapp.settings import Settings
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite.floors import (
    NewFloor,
    check_floors,
    check_removable,
    photos_on_floor,
    plan_transform,
)
from webapp.tasks.satellite.upright import upright_copy, upright_name


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
