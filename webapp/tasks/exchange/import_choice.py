"""Which `.cfg` of an unpacked zip is the map, and which are placements of it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path, PurePosixPath

from webapp.core.mapmodel.findings import quoted
from webapp.core.mapmodel.model import Map, Placement
from webapp.errors import InputError, MapError
from webapp.files.atomic import write_bytes
from webapp.files.exchange.map_zip import Unpacked
from webapp.files.maps.cfg import read_cfg
from webapp.files.maps.folder import json_path, placement_path, read_map, read_map_json
from webapp.files.maps.map_json import check_placement_name, format_map_json


def choose_map(unpacked: Unpacked) -> Path:
    """Find the map, and give it its usual names: `map.cfg` and `map.json`.

    A `.cfg` that another one's JSON calls its placement is none; of several that are left, `map.cfg` is it.

    Returns
    -------
    Path
        Its `map.cfg`.

    Raises
    ------
    InputError
        There is none, or there are several.
    """
    paths = [unpacked.folder / name for name in unpacked.cfgs]
    if not paths:
        raise InputError("the zip has no map: there is no .cfg in it", hint="zip the folder with its map.cfg")
    known = {other for path in paths for other in _known_placements(path)}
    maps = [path for path in paths if path not in known] or paths
    named = [path for path in maps if path.name.lower() == "map.cfg"]
    if len(maps) > 1 and len(named) != 1:
        raise InputError(
            f"the zip has several maps: {_listed(maps, unpacked.folder)}",
            hint="zip one map at a time, or give the main one the name map.cfg",
        )
    chosen = named[0] if named else maps[0]
    elsewhere = [path for path in maps if path.parent != chosen.parent]
    if elsewhere:
        raise InputError(
            f"the zip has further maps in other folders: {_listed(elsewhere, unpacked.folder)}",
            hint="zip one map at a time",
        )
    cfg = chosen.with_name("map.cfg")
    if chosen != cfg:
        if json_path(chosen).exists():
            json_path(chosen).replace(json_path(cfg))
        chosen.replace(cfg)
    return cfg


def add_placements(cfg: Path) -> None:
    """Make placements of the other `.cfg` files beside a map that is fine, in its `map.json`.

    Raises
    ------
    InputError
        One is no placement of this map.
    MapError
        One cannot be read.
    """
    map_ = read_map(cfg)
    there = {cfg, *(placement_path(cfg, p.name) for p in map_.placements)}
    others = [path for path in sorted(cfg.parent.glob("*.cfg")) if path not in there]
    strangers = [path for path in others if not _is_placement(path, map_)]
    if strangers:
        raise InputError(
            f"these are no placements of {cfg.name}, for they have another image or other photos: "
            f"{_listed(strangers, cfg.parent)}",
            hint="a placement has the first line, ids and photos of the map; zip other maps on their own",
        )
    if others:
        new = [Placement(p.stem, {e.id: e.position for e in read_cfg(p).map.experiences}) for p in others]
        write_bytes(json_path(cfg), format_map_json(replace(map_, placements=(*map_.placements, *new))))


def _known_placements(path: Path) -> list[Path]:
    """List the files that the JSON of a `.cfg` calls its placements; the linter tells where it is damaged."""
    try:
        return [placement_path(path, name) for name in read_map_json(path).placements]
    except MapError:
        return []


def _is_placement(path: Path, map_: Map) -> bool:
    other = read_cfg(path).map
    photos = {e.id: e.photo for e in map_.experiences}
    try:
        check_placement_name(path.stem)
    except MapError:
        return False
    same = all(photos.get(e.id) == e.photo for e in other.experiences)
    return same and other.satellite == map_.satellite and path.suffix == ".cfg"


def _listed(paths: Collection[Path], folder: Path) -> str:
    names = [PurePosixPath(path.relative_to(folder)).as_posix() for path in paths]
    return ", ".join(quoted(name) for name in names[:10]) + (" ..." if len(names) > 10 else "")
