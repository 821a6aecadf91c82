"""A whole map as a zip: map files, satellite image and photos; can be imported again as it is.

Photos that wait for a place are in a folder of their own: no map file names them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from webapp.errors import MapError
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.files.maps.cfg import read_bytes
from webapp.files.maps.folder import json_path, photo_path, placement_path
from webapp.progress import Progress
from webapp.store.library import Library
from webapp.tasks.exchange.export_cfg import map_files
from webapp.tasks.exchange.export_source import Download, Source, of_library

UNPLACED = "unplaced"
"""Folder of the zip with the photos in the tray, below it where they are in the map's folder."""


def run(library: Library, map_id: int, *, progress: Progress | None = None) -> Download:
    """Give a map of the library as a zip, made while it is taken.

    Photos that are missing on the disk are missing in it too: the linter reports them after an import.

    Parameters
    ----------
    progress : Progress, optional
        One step a photo.

    Raises
    ------
    NotFound, UsageError
        There is no such map, or it has no satellite image yet.
    """
    source = of_library(library, map_id)
    return _zip(source, map_files(library, map_id, source=source), progress or Progress())


def of_folder(source: Source, *, progress: Progress | None = None) -> Download:
    """Give a map in any folder as a zip."""
    paths = [source.cfg, json_path(source.cfg)]
    paths += [placement_path(source.cfg, p.name) for p in source.map.placements]
    texts = {path.name: read_bytes(path) for path in paths if path.exists()}
    return _zip(source, texts, progress or Progress())


def _zip(source: Source, texts: Mapping[str, bytes], progress: Progress) -> Download:
    return Download(f"{source.name}.zip", "application/zip", stream_zip(_members(source, texts, progress)))


def _members(source: Source, texts: Mapping[str, bytes], progress: Progress) -> Iterator[ZipMember]:
    for name, text in texts.items():
        yield ZipMember(name, text)
    names = dict.fromkeys([source.map.satellite.path, *(e.photo for e in source.map.experiences)])
    members = [*((name, name) for name in names), *_unplaced(source, taken=set(names))]
    progress.size(len(members))
    for member, name in members:
        progress.check()
        path = _path(source.cfg, name)
        if path is not None:
            yield ZipMember(member, path)
        progress.advance()


def _unplaced(source: Source, *, taken: set[str]) -> Iterator[tuple[str, str]]:
    """Name the photos in the tray: in the zip, and in the map's folder."""
    for name in dict.fromkeys(source.unplaced):
        member = f"{UNPLACED}/{name}"
        while member in taken:  # the map has a folder of that name
            member = f"{UNPLACED}/{member}"
        if name not in taken:
            yield member, name


def _path(cfg: Path, name: str) -> Path | None:
    """Find a file of the map; None where it is missing or a link leads out of the folder."""
    try:
        path = photo_path(cfg, name)
    except MapError:
        return None
    return path if path.is_file() else None
