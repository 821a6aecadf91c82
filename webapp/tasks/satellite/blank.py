"""Gives a library map a blank plan to draw on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.blank import draw, draw_sheet, plan_around
from webapp.errors import UsageError
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite import display
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX, Applied, ImageChoice, NewImage, set_image
from webapp.tasks.satellite.files import keep_pixels
from webapp.tasks.satellite.unused import taken_back_if_refused

SMALLEST_PX, LARGEST_PX = 100, 10_000


@dataclass(frozen=True, slots=True)
class Sheet:
    """Size of a plan without a place on the Earth, pixels."""

    width: int
    height: int


def make_blank(library: Library, map_id: int, *, sheet: Sheet | None, choice: ImageChoice) -> Applied:
    """Draw a blank plan and give it to the map as one edit.

    Parameters
    ----------
    sheet : Sheet or None
        None lays a plan around the GPS positions of the map's photos, with 5 % of their extent as a margin.

    Raises
    ------
    UsageError
        The size is out of range, no photo has a GPS position, or placed photos would not lie on the plan.
    StorageError
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
    with taken_back_if_refused(library, map_id, name=name):
        return set_image(library.changing, map_id, new=NewImage(name, image), choice=choice)


def _sheet(sheet: Sheet) -> tuple[NDArray[np.uint8], MapImage]:
    for side in (sheet.width, sheet.height):
        if not SMALLEST_PX <= side <= LARGEST_PX:
            raise UsageError(
                f"a plan has {SMALLEST_PX} to {LARGEST_PX} pixels a side, not {side}", where="width, height"
            )
    return draw_sheet(sheet.width, sheet.height), MapImage(sheet.width, sheet.height, None)


def _around(positions: list[tuple[float, float]]) -> tuple[NDArray[np.uint8], MapImage]:
    plan = plan_around(positions)
    return draw(plan), MapImage(plan.width, plan.height, plan.georeference)
