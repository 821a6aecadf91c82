"""Example queries of a map, such as the sample map: photos in `queries` next to its `.cfg`.

If `queries.csv` lists the positions of some of them, the others were taken elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from webapp.errors import NotFound, TableError
from webapp.files.localize import queries_csv
from webapp.files.part_file import sha256_of
from webapp.files.photos.photo import previews_folder
from webapp.tasks.maps.pictures import PhotoFile

FOLDER = "queries"
LIST = "queries.csv"

_ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
_MOST = 12


@dataclass(frozen=True, slots=True)
class Example:
    """File name of an example photo, and whether it was taken outside the map."""

    name: str
    elsewhere: bool


def examples_of(cfg: Path) -> list[Example]:
    """List a map's example photos, those from elsewhere last."""
    folder = cfg.parent / FOLDER
    if not folder.is_dir() or folder.is_symlink():
        return []
    files = (path for path in folder.iterdir() if path.suffix.lower() in _ENDINGS)
    names = sorted(path.name for path in files if path.is_file() and not path.is_symlink())
    listed = _listed(cfg.parent / LIST)
    examples = [Example(name, bool(listed) and f"{FOLDER}/{name}" not in listed) for name in names]
    return sorted(examples, key=lambda example: example.elsewhere)[:_MOST]


def _listed(path: Path) -> set[str]:
    try:
        return {query.name for query in queries_csv.read(path)}
    except TableError:  # missing or of another format: no positions are known
        return set()


def path_of(cfg: Path, name: str) -> Path:
    if name not in (example.name for example in examples_of(cfg)):
        raise NotFound("the map has no such example photo", hint="reload the page")
    return cfg.parent / FOLDER / name


def file_of(cfg: Path, name: str) -> PhotoFile:
    """Return an example photo as its pictures are made of it."""
    path = path_of(cfg, name)
    sha256 = sha256_of(path)
    return PhotoFile(name, sha256, lambda: path, previews_folder(cfg.parent), f"example-{sha256[:16]}")
