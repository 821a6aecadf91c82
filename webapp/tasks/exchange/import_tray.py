"""Imports the unplaced photos of a zip into the tray of the new map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from webapp.errors import PhotoError
from webapp.files.atomic import storage_error
from webapp.files.listing import folded, list_photos
from webapp.files.maps.cfg import read_bytes
from webapp.files.maps.cfg_scan import scan
from webapp.files.photos.sidecars import sidecars_in
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.store.schema import Photo
from webapp.tasks.exchange.export_files import UNPLACED
from webapp.tasks.maps import adopt_map
from webapp.tasks.maps.adopt_map import FolderContents
from webapp.tasks.maps.check_map import orphan_photos


@dataclass(frozen=True, slots=True)
class Tray:
    """Unplaced photos that are set aside during an import."""

    folder: Path  # Temporary folder outside the map, whose linter would report them as orphans
    names: tuple[str, ...]  # Their paths in that folder, which are also those to use in the map's folder


def set_aside(cfg: Path, folder: Path) -> Tray:
    """Move the photos in `unplaced/` that no `.cfg` of the map names. Raises StorageError.

    Args:
        folder: A new folder on the same disk, not below the map's.
    """
    orphans = orphan_photos(cfg, scan(read_bytes(cfg)), present=list_photos(cfg.parent))
    names = tuple(name.removeprefix(f"{UNPLACED}/") for name in orphans if name.startswith(f"{UNPLACED}/"))
    there = cfg.parent / UNPLACED
    beside = sidecars_in(there) if there.is_dir() else None
    for name in names:
        for file in (name, *(() if beside is None else beside.of(name))):
            if not (folder / file).exists():  # two photos may share one
                _move(there / file, folder / file, name=file)
    _drop_empty(cfg.parent / UNPLACED)
    return Tray(folder, names)


def take_back(
    contents: FolderContents, tray: Tray, *, cfg: Path, limits: PhotoLimits, progress: Progress
) -> tuple[FolderContents, tuple[str, ...]]:
    """Move photos into the folder of their map and add their records to its contents.

    Photos that the map has already are left out. Those listed in `map.json` keep their ids, and with them the
    order of the map's photos. Raises StorageError, Cancelled.

    Returns:
        left_out: Files by their names in the zip, each with the reason.
    """
    rows: list[Photo] = []
    left_out: list[str] = []
    known = {row.sha256 for row in contents.photos}
    names = _Names(cfg.parent)
    listed = {photo.photo: photo for photo in contents.map.unplaced}
    free = contents.map.next_id
    beside = sidecars_in(tray.folder) if tray.names else None
    for name in tray.names:
        progress.check()
        listing = listed.get(name)
        try:
            others = [tray.folder / other for other in (beside.of(name) if beside else ())]
            row = adopt_map.tray_row(tray.folder / name, known=listing, beside=others, limits=limits)
        except PhotoError as error:
            left_out.append(f"{UNPLACED}/{name}: {error.message}")
            continue
        if row.sha256 in known:
            left_out.append(f"{UNPLACED}/{name}: the map has this photo already")
            continue
        known.add(row.sha256)
        row.id, row.path = free if listing is None else listing.id, names.take(name)
        free += listing is None
        _move(tray.folder / name, cfg.parent / row.path, name=name)
        rows.append(row)
    return replace(contents, tray=tuple(rows)), tuple(left_out)


class _Names:
    """The names of a folder's files, compared as on a case-insensitive file system."""

    def __init__(self, folder: Path) -> None:
        self._files: set[str] = set()
        self._folders: set[str] = set()
        for path in folder.rglob("*"):
            if path.is_file():
                self._add(path.relative_to(folder).as_posix())

    def take(self, name: str) -> str:
        """Reserve the name of a new file, with the prefix `unplaced/` if the name is taken."""
        while self._is_barred(name):
            name = f"{UNPLACED}/{name}"
        self._add(name)
        return name

    def _add(self, name: str) -> None:
        self._files.add(folded(name))
        self._folders.update(_above(name))

    def _is_barred(self, name: str) -> bool:
        above_or_below = folded(name) in self._folders or not self._files.isdisjoint(_above(name))
        return above_or_below or folded(name) in self._files


def _above(name: str) -> list[str]:
    return [folded(str(parent)) for parent in PurePosixPath(name).parents]


def _drop_empty(folder: Path) -> None:
    """Delete the empty folders in a folder, then the folder itself if it is empty."""
    below = [path for path in folder.rglob("*") if path.is_dir()]
    for path in sorted([folder, *below], reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _move(source: Path, target: Path, *, name: str) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
    except OSError as error:
        raise storage_error(error, where=f"{UNPLACED}/{name}") from error
