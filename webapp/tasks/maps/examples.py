"""Photos that come with a map to try it on, as with the sample: those in `queries` next to its `.cfg`."""

from __future__ import annotations

from pathlib import Path

from webapp.errors import NotFound
from webapp.files.photos.preview import make_previews, preview_path, write_previews
from webapp.settings import PhotoLimits

FOLDER = "queries"

_ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
_MOST = 12


def names_of(cfg: Path) -> list[str]:
    """List the file names of a map's example photos."""
    folder = cfg.parent / FOLDER
    if not folder.is_dir() or folder.is_symlink():
        return []
    files = (path for path in folder.iterdir() if path.suffix.lower() in _ENDINGS)
    return sorted(path.name for path in files if path.is_file() and not path.is_symlink())[:_MOST]


def path_of(cfg: Path, name: str) -> Path:
    """Find an example photo.

    Raises
    ------
    NotFound
        The map has none of that name.
    """
    if name not in names_of(cfg):
        raise NotFound("the map has no such example photo", hint="reload the page")
    return cfg.parent / FOLDER / name


def thumb_of(cfg: Path, name: str, *, limits: PhotoLimits) -> Path:
    """Find the small picture of an example photo; made when it is asked for first.

    Raises
    ------
    NotFound, PhotoError, StorageError
    """
    photo, key = path_of(cfg, name), f"example-{name}"
    thumb = preview_path(cfg.parent, key, kind="thumb")
    if not thumb.exists():
        write_previews(cfg.parent, key, previews=make_previews(photo, limits=limits))
    return thumb
