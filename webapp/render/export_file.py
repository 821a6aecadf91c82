"""All export formats of a map, by name, and storage of the exported file."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

from webapp.errors import NotFound, UsageError
from webapp.files.atomic import storage_error
from webapp.files.listing import DERIVED
from webapp.progress import Progress
from webapp.render import folium_page
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of_files
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import export_files, write_exif
from webapp.tasks.exchange.export_source import Download, Source, of_library

Format = Literal["zip", "geojson", "kml", "kmz", "html", "exif", "xmp", "csv"]
FORMATS: tuple[Format, ...] = get_args(Format)

_KEEP_S = 7 * 86_400


def export_map_file(
    library: Library, map_id: int, *, form: str, settings: Settings, progress: Progress | None = None
) -> Download:
    """Export a map of the library.

    Raises:
        UsageError: The format is unknown, or the map lacks what it needs.
    """
    progress = progress or Progress()
    if form == "zip":
        return export_files.export_map_zip(library, map_id, progress=progress)
    makers: dict[str, Callable[[Source], Download]] = {
        "geojson": export_files.export_map_geojson,
        "kml": export_files.export_map_kml,
        "kmz": lambda source: export_files.export_map_kmz(source, settings=settings, progress=progress),
        "html": lambda source: folium_page.export_map_page(source, settings=settings, progress=progress),
        "exif": lambda source: write_exif.export_geotagged(source, limits=settings.photo, progress=progress),
        "xmp": lambda source: write_exif.export_sidecars(source, limits=settings.photo),
        "csv": lambda source: write_exif.export_exiftool_csv(source, limits=settings.photo),
    }
    if form not in makers:
        raise UsageError(f"unknown export format {form!r}", where="format", hint=f"use {', '.join(FORMATS)}")
    return makers[form](of_library(library, map_id))


def keep(library: Library, slug: str, *, download: Download, blurring: str | None) -> str:
    """Write an export into the map's `derived/exports`, where it is kept for a week. Raises StorageError.

    Args:
        blurring: What was blurred before it was made, from `blurring_of`.
    """
    folder = _folder(library, slug)
    path = _kept_path(folder, download.name, blurring)
    part = path.with_name(f"{path.name}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.iterdir():
            if time.time() - old.stat().st_mtime > _KEEP_S:
                old.unlink()
        with part.open("wb") as file:
            file.writelines(download.pieces)
        part.replace(path)
    except OSError as error:
        raise storage_error(error, where=download.name) from error
    finally:
        part.unlink(missing_ok=True)
    return download.name


def kept(library: Library, record: MapRecord, *, name: str) -> Path:
    """Return an export that was kept; one that was made before a photo was blurred is never returned.

    Raises NotFound.
    """
    folder = _folder(library, record.slug)
    path = _kept_path(folder, name, blurring_of(library, record))
    there = [file.name for file in folder.iterdir()] if folder.is_dir() else []
    if path.name not in there or name.endswith(".part"):
        raise NotFound("export not found, or it has expired", hint="export the map again")
    return path


def blurring_of(library: Library, record: MapRecord) -> str | None:
    """Return a key of what is blurred in the photos of a map for recipients of an export; None if nothing."""
    with library.database.read() as session:
        found = boxes_of_files(session, (photo.sha256 for photo in maps.photos(session, record)))
    return hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()[:12] if found else None


def _kept_path(folder: Path, name: str, blurring: str | None) -> Path:
    return folder / (name if blurring is None else f"{name}.{blurring}")


def _folder(library: Library, slug: str) -> Path:
    return library.map_folder(slug) / DERIVED / "exports"
