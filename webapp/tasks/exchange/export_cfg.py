"""The map files of a library map, to take away: `map.cfg`, `map.json`, and the `.cfg` of each placement."""

from __future__ import annotations

from collections.abc import Mapping

from filelock import FileLock

from webapp.core.mapmodel.model import Map
from webapp.errors import NotFound
from webapp.files.maps.cfg import format_cfg, read_bytes
from webapp.files.maps.folder import json_path, placed_map, placement_path
from webapp.files.maps.map_json import format_map_json
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download, Source, of_library
from webapp.tasks.maps import export

MEDIA_TYPE = "text/plain; charset=utf-8"


def run(library: Library, map_id: int, *, placement: str | None = None) -> Download:
    """Give a map file.

    Parameters
    ----------
    placement : str or None
        That of a further placement.

    Raises
    ------
    NotFound
        There is no such map or placement.
    UsageError
        The map has no satellite image yet.
    """
    source = of_library(library, map_id)
    name = "map.cfg" if placement is None else f"{placement}.cfg"
    texts = map_files(library, map_id, source=source)
    if name not in texts:
        raise NotFound(f"the map has no placement {placement!r}", hint="reload the page")
    own = source.name if placement is None else f"{source.name}-{placement}"
    return Download(f"{own}.cfg", MEDIA_TYPE, iter([texts[name]]))


def map_files(library: Library, map_id: int, *, source: Source) -> dict[str, bytes]:
    """Give the text files of a map, all of one state.

    As they are on the disk; where somebody has changed the `.cfg` there, as the database has them.

    Returns
    -------
    dict of str to bytes
        By name: `map.cfg`, `map.json` where the map needs one, `NAME.cfg`.
    """
    if not export.export_map(library, map_id):
        return texts_of(source.map)
    with FileLock(source.cfg.parent / "derived" / export.LOCK):
        paths = [source.cfg, json_path(source.cfg)]
        paths += [placement_path(source.cfg, p.name) for p in source.map.placements]
        return {path.name: read_bytes(path) for path in paths if path.exists()}


def texts_of(map_: Map) -> dict[str, bytes]:
    """Write the text files of a map as values."""
    texts: Mapping[str, bytes] = {
        "map.cfg": format_cfg(map_),
        "map.json": format_map_json(map_),
    }
    return {**texts, **{f"{p.name}.cfg": format_cfg(placed_map(map_, p)) for p in map_.placements}}
