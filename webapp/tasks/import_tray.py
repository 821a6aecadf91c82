"""Takes the photos of a zip that have no place yet into the tray of the new map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from webapp.errors import PhotoError
from webapp.files.cfg import read_bytes
from webapp.files.cfgscan import scan
from webapp.files.listing import list_photos
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.store.schema import Photo
from webapp.tasks import adopt_map
from webapp.tasks.adopt_map import Contents
from webapp.tasks.check_map import orphan_photos
from webapp.tasks.export_zip import UNPLACED


@dataclass(frozen=True, slots=True)
class Tray:
    """Photos that wait for a place.

    Attributes
    ----------
    folder : Path
        Where they are meanwhile: beside the map, whose linter would ask why it does not name them.
    names : tuple of str
        Their paths in there, as they shall be in the map's folder.
    """

    folder: Path
    names: tuple[str, ...]


def set_aside(cfg: Path, folder: Path) -> Tray:
    """Move the photos in `unplaced/` that no `.cfg` of the map names.

    Parameters
    ----------
    cfg : Path
    folder : Path
        New, on the same disk, and not below the map's.
    """
    orphans = orphan_photos(cfg, scan(read_bytes(cfg)), present=list_photos(cfg.parent))
    names = tuple(name.removeprefix(f"{UNPLACED}/") for name in orphans if name.startswith(f"{UNPLACED}/"))
    for name in names:
        _move(cfg.parent / UNPLACED / name, folder / name)
    _drop_empty(cfg.parent / UNPLACED)
    return Tray(folder, names)


def take_back(
    contents: Contents, tray: Tray, *, cfg: Path, limits: PhotoLimits, progress: Progress
) -> tuple[Contents, tuple[str, ...]]:
    """Move photos into the folder of their map and add their records to its contents.

    Those that the map has already are left out.

    Returns
    -------
    contents : Contents
    refused : tuple of str
        Files that are no photos, as the zip names them.

    Raises
    ------
    Cancelled
    """
    rows: list[Photo] = []
    refused: list[str] = []
    known = {row.sha256 for row in contents.photos}
    for name in tray.names:
        progress.check()
        try:
            row = adopt_map.tray_row(tray.folder / name, limits=limits)
        except PhotoError:
            refused.append(f"{UNPLACED}/{name}")
            continue
        if row.sha256 in known:
            continue
        known.add(row.sha256)
        row.id, row.path = contents.map.next_id + len(rows), _free(cfg.parent, name)
        _move(tray.folder / name, cfg.parent / row.path)
        rows.append(row)
    return replace(contents, tray=tuple(rows)), tuple(refused)


def _free(folder: Path, name: str) -> str:
    """Name a file as it was, or below `unplaced/` where the map has such a file."""
    while (folder / name).exists():
        name = f"{UNPLACED}/{name}"
    return name


def _drop_empty(folder: Path) -> None:
    """Delete a folder, and those in it, where no files are left."""
    below = [path for path in folder.rglob("*") if path.is_dir()]
    for path in sorted([folder, *below], reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    source.rename(target)
