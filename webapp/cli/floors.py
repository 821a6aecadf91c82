"""`expmap map floors`: list, add and remove the floors of a map."""

from __future__ import annotations

import json
import secrets
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.core.geo.floors import BASE_FLOOR, LARGEST_LEVEL, Floor
from webapp.core.mapmodel.model import Map
from webapp.errors import UsageError
from webapp.files.maps.folder import read_map
from webapp.files.maps.lists import floor_fields
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.landmarks.accept import library_of, owner_of
from webapp.tasks.maps import export
from webapp.tasks.satellite import floors as edit_floors
from webapp.tasks.satellite.floors import NewFloor

_LEVEL = click.FloatRange(-LARGEST_LEVEL, LARGEST_LEVEL)
_IMAGE = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command("floors", short_help="List, add or remove the floors of a map.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option("--add", metavar="NAME", help="Add a floor of this name, at --level.")
@click.option("--level", type=_LEVEL, metavar="N", help="Its level: 0 at the ground, 1 above, -1 below.")
@click.option("--height", type=float, metavar="METRES", help="Its height.")
@click.option("--image", type=_IMAGE, metavar="FILE", help="Its plan: PNG, JPEG or TIFF.")
@click.option("--remove", metavar="NAME", help="Remove a floor, by its name or level.")
@click.option("--tray", is_flag=True, help="Move the photos of the removed floor to the tray.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def floors(
    cfg: Path,
    add: str | None,
    level: float | None,
    height: float | None,
    image: Path | None,
    remove: str | None,
    tray: bool,
    as_json: bool,
) -> None:
    """List the floors of a map, the highest first, with the photos on each; add one, or remove one.

    A new plan is stretched over the whole image of the map; in the editor it is aligned by pairs of spots.
    Adding the first floor turns the map's own image into "Ground floor", at level 0.
    """
    if (add is None) != (level is None):
        raise click.UsageError("--add and --level must be used together")
    if add is None and (height is not None or image is not None):
        raise click.UsageError("--height and --image can only be used with --add")
    settings = settings_in_use(cfg)
    base = Floor(BASE_FLOOR, "Ground floor", 0.0)
    new = None
    if add is not None and level is not None:
        new = NewFloor(Floor(BASE_FLOOR, add.strip(), level, height), base, image)
    with library_of(cfg, settings=settings) as there:
        gone = None if remove is None else _named(read_map(cfg), remove)
        if there is None:
            if gone is not None:
                edit_floors.remove_in_folder(cfg, gone, to_tray=tray)
            if new is not None:
                edit_floors.add_in_folder(cfg, new=new, settings=settings)
        else:
            library, map_id = there
            if gone is not None:
                owner = owner_of(library)
                edit_floors.remove_floor(library, map_id, id=gone, to_tray=tray, account_id=owner)
            if new is not None:
                _add_in_library(library, map_id, new=new, settings=settings)
            export.export_map(library, map_id)
        the_map = read_map(cfg)
    click.echo(json.dumps(_as_json(the_map), indent=1) if as_json else _table(the_map))


def _add_in_library(library: Library, map_id: int, *, new: NewFloor, settings: Settings) -> None:
    copy = None
    if new.file is not None:
        copy = library.uploads / f"{secrets.token_hex(16)}.image"
        shutil.copyfile(new.file, copy)
    new, owner = replace(new, file=copy), owner_of(library)
    edit_floors.add_floor(library, map_id, new=new, account_id=owner, settings=settings)


def _named(the_map: Map, wanted: str) -> int:
    for floor in the_map.floors:
        if wanted in (floor.name, f"{floor.level:g}"):
            return floor.id
    names = ", ".join(f"{floor.name} ({floor.level:g})" for floor in the_map.floors) or "none"
    raise UsageError(f"the map has no floor {wanted!r}", hint=f"its floors are: {names}")


def _counts(the_map: Map) -> Counter[int]:
    return Counter(e.floor for e in the_map.experiences)


def _as_json(the_map: Map) -> dict[str, object]:
    photos = _counts(the_map)
    return {
        "floors": [
            {
                "id": floor.id,
                "height_m": None,
                "image": None,
                **floor_fields(floor),
                "photos": photos[floor.id],
            }
            for floor in sorted(the_map.floors, key=lambda floor: floor.level)
        ]
    }


def _table(the_map: Map) -> str:
    if not the_map.floors:
        return "the map has only one image; --add adds a floor"
    photos = _counts(the_map)
    rows = [
        (
            f"{floor.level:g}",
            floor.name,
            "" if floor.height_m is None else f"{floor.height_m:g} m",
            f"{photos[floor.id]} photos",
            the_map.satellite.path if floor.image is None else floor.image.path,
        )
        for floor in sorted(the_map.floors, key=lambda floor: -floor.level)
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)
