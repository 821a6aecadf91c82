"""Gives a library map an uploaded satellite image."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from webapp.core.geo.georeference import Georeference
from webapp.errors import GeoreferenceError
from webapp.files.satellite.georeference_files import read_geotiff
from webapp.files.satellite.raster import opened_raster, reduced
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite import display
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX, Applied, ImageChoice, NewImage, set_image
from webapp.tasks.satellite.files import as_shown, keep_file
from webapp.tasks.satellite.georeference import GeoWish, fit
from webapp.tasks.satellite.unused import taken_back_if_refused


@dataclass(frozen=True, slots=True)
class Uploaded:
    """What became of an uploaded image.

    Attributes
    ----------
    warnings : tuple of str
        About its georeference.
    """

    applied: Applied
    warnings: tuple[str, ...]


def store_upload(
    library: Library,
    map_id: int,
    *,
    file: Path,
    wish: GeoWish | None,
    choice: ImageChoice,
    settings: Settings,
) -> Uploaded:
    """Check an image, keep it in the map's folder, and give it to the map as one edit.

    Parameters
    ----------
    file : Path
        In the library's uploads folder; is gone afterwards.
    wish : GeoWish or None
        Where it is on the Earth. None takes what a GeoTIFF says, else nothing.

    Raises
    ------
    PhotoError
        It is no PNG, JPEG or TIFF, damaged, or larger than the limits.
    GeoreferenceError
        What was wished gives no georeference.
    UsageError
        Placed photos would not lie on it.
    StorageError
        The disk refused.
    """
    with library.database.read() as session:
        folder = library.map_folder(session.get_one(MapRecord, map_id).slug)
    with ExitStack() as cleanup:
        cleanup.callback(file.unlink, missing_ok=True)
        shown = as_shown(file, scratch=library.uploads, settings=settings)
        cleanup.callback(shown.unlink, missing_ok=True)
        with opened_raster(shown, limits=settings.satellite) as raster:
            width, height = raster.width, raster.height
            # reads all of it: what is damaged or cut off is refused before the map changes
            small = reduced(raster, display.PREVIEW_PX)
        if wish is None:
            georeference, warnings = _own(file)
        else:
            found = fit(wish, width=width, height=height)
            georeference, warnings = found.georeference, found.warnings
        name = keep_file(shown, folder)
    display.write_small(folder, name, small=small, large=max(width, height) > DISPLAY_SIDE_PX)
    new = NewImage(name, MapImage(width, height, georeference))
    with taken_back_if_refused(library, map_id, name=name):
        return Uploaded(set_image(library.changing, map_id, new=new, choice=choice), warnings)


def _own(file: Path) -> tuple[Georeference | None, tuple[str, ...]]:
    """Take the georeference of a GeoTIFF; without one the image is still good, and a warning says so."""
    with file.open("rb") as opened:
        if opened.read(2) not in (b"II", b"MM"):
            return None, ()
    try:
        found = read_geotiff(file)
    except GeoreferenceError as error:
        return None, (error.message,)
    return found.georeference, found.warnings
