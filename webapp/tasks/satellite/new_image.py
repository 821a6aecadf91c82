"""Gives a library map a new satellite image: an uploaded one, or a blank plan."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.blank import draw, draw_sheet, plan_around
from webapp.core.geo.georeference import Georeference
from webapp.errors import GeoreferenceError, UsageError
from webapp.files.satellite.georeference_files import read_geotiff
from webapp.files.satellite.raster import keep_file, keep_pixels, opened_raster, reduced
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite import display
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX, ImageChoice, ImageEditResult, NewImage, set_image
from webapp.tasks.satellite.files import removed_if_refused
from webapp.tasks.satellite.georeference import GeoreferenceRequest, fit
from webapp.tasks.satellite.upright import as_shown, turned_note

SMALLEST_PX, LARGEST_PX = 100, 10_000


@dataclass(frozen=True, slots=True)
class UploadedImage:
    applied: ImageEditResult
    warnings: tuple[str, ...]  # About its georeference, and whether it was turned


def store_upload(
    library: Library,
    map_id: int,
    *,
    file: Path,
    request: GeoreferenceRequest | None,
    choice: ImageChoice,
    settings: Settings,
) -> UploadedImage:
    """Check an image, store it in the map's folder, and set it as one edit.

    Args:
        file: In the library's uploads folder; it is deleted afterwards.
        request: Its georeference. None takes that of a GeoTIFF, if there is one.

    Raises:
        PhotoError: It is not a PNG, JPEG or TIFF, damaged, or larger than the limits.
        GeoreferenceError: The request gives no georeference.
        UsageError: Placed photos would not lie on it.
        StorageError: Writing failed.
    """
    with library.database.read() as session:
        folder = library.map_folder(session.get_one(MapRecord, map_id).slug)
    with ExitStack() as cleanup:
        cleanup.callback(file.unlink, missing_ok=True)
        shown = as_shown(file, scratch=library.uploads, settings=settings)
        cleanup.callback(shown.unlink, missing_ok=True)
        with opened_raster(shown, limits=settings.satellite) as raster:
            width, height = raster.width, raster.height
            # reads the whole file: a damaged or truncated one is refused before the map changes
            small = reduced(raster, display.PREVIEW_PX)
        if request is None:
            georeference, warnings = _own(file)
        else:
            found = fit(request, width=width, height=height)
            georeference, warnings = found.georeference, found.warnings
        warnings = (*warnings, *filter(None, [turned_note(file, settings)]))
        name = keep_file(shown, folder)
    display.write_small(folder, name, small=small, large=max(width, height) > DISPLAY_SIDE_PX)
    new = NewImage(name, MapImage(width, height, georeference))
    with removed_if_refused(library, map_id, name=name):
        return UploadedImage(set_image(library.changing, map_id, new=new, choice=choice), warnings)


def _own(file: Path) -> tuple[Georeference | None, tuple[str, ...]]:
    """Return the georeference of a GeoTIFF and warnings; None for other images, or if it has none."""
    with file.open("rb") as opened:
        if opened.read(2) not in (b"II", b"MM"):
            return None, ()
    try:
        found = read_geotiff(file)
    except GeoreferenceError as error:
        return None, (error.message,)
    return found.georeference, found.warnings


@dataclass(frozen=True, slots=True)
class PlanSize:
    """Size of a plan without a georeference, pixels."""

    width: int
    height: int


def make_blank(
    library: Library, map_id: int, *, sheet: PlanSize | None, choice: ImageChoice
) -> ImageEditResult:
    """Draw a blank plan and set it as the map's image, as one edit.

    Args:
        sheet: None makes a plan around the GPS positions of the map's photos, with 5 % of their extent as a
            margin.

    Raises:
        UsageError: The size is out of range, no photo has a GPS position, or placed photos would not lie on
            the plan.
    """
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        folder = library.map_folder(record.slug)
        positions = [
            (p.gps_lat, p.gps_lon)
            for p in maps.photos(session, record)
            if p.gps_lat is not None and p.gps_lon is not None and not p.removed
        ]
    if sheet is None and not positions:
        raise UsageError("no photo of the map has a GPS position", hint="give the plan a width and a height")
    pixels, image = _sheet(sheet) if sheet else _around(positions)
    name = keep_pixels(pixels, folder)
    rgb = np.ascontiguousarray(pixels[:, :, ::-1])
    large = max(image.width, image.height) > DISPLAY_SIDE_PX
    display.write_small(folder, name, small=rgb, large=large)
    with removed_if_refused(library, map_id, name=name):
        return set_image(library.changing, map_id, new=NewImage(name, image), choice=choice)


def _sheet(sheet: PlanSize) -> tuple[NDArray[np.uint8], MapImage]:
    for side in (sheet.width, sheet.height):
        if not SMALLEST_PX <= side <= LARGEST_PX:
            raise UsageError(
                f"a plan has {SMALLEST_PX} to {LARGEST_PX} pixels a side, not {side}", where="width, height"
            )
    return draw_sheet(sheet.width, sheet.height), MapImage(sheet.width, sheet.height, None)


def _around(positions: list[tuple[float, float]]) -> tuple[NDArray[np.uint8], MapImage]:
    plan = plan_around(positions)
    return draw(plan), MapImage(plan.width, plan.height, plan.georeference)
