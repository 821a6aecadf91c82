"""Which part of the satellite image a map picture shows, and how large."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Map
from webapp.render.canvas import Point

MAX_SCALE = 8.0
ZOOM = 3.0
"""How much larger a detail is than the whole."""


@dataclass(frozen=True, slots=True)
class View:
    """A part of the satellite image, scaled.

    Attributes
    ----------
    left, top, right, bottom : int
        Map pixels.
    scale : float
        Picture pixels a map pixel.
    """

    left: int
    top: int
    right: int
    bottom: int
    scale: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in the picture."""
        width, height = (self.right - self.left) * self.scale, (self.bottom - self.top) * self.scale
        return max(1, round(width)), max(1, round(height))

    def shown(self, position: MapPixel) -> Point:
        """Where a map position is in the view, counted from the centre of its first pixel."""
        return (position.x - self.left) * self.scale - 0.5, (position.y - self.top) * self.scale - 0.5

    def fitted(self, size: tuple[int, int]) -> View:
        """Scale the same part to be as large as fits into `size`."""
        width, height = self.right - self.left, self.bottom - self.top
        scale = min(size[0] / width, size[1] / height, MAX_SCALE)
        return View(self.left, self.top, self.right, self.bottom, scale)


def overview(themap: Map, positions: list[MapPixel]) -> View:
    """Show all experiences and all `positions` with a margin, at the image's own size."""
    width, height = themap.satellite.width, themap.satellite.height
    seen = np.array([*(e.position for e in themap.experiences), *positions], dtype=np.float64).reshape(-1, 2)
    if not len(seen):
        return View(0, 0, width, height, 1.0)
    # A map with few photos still shows their surroundings: at least a quarter of the image.
    low, high = seen.min(axis=0), seen.max(axis=0)
    spread = np.maximum(high - low, max(width, height) / 4) * 1.14
    return _around((low + high) / 2, spread, (width, height), scale=1.0)


def detail(themap: Map, whole: View, *, centre: MapPixel, size: tuple[int, int]) -> View:
    """Show the surroundings of a position enlarged, in a picture of at most `size`."""
    scale = min(ZOOM * whole.scale, MAX_SCALE)
    spread = np.array(size, dtype=np.float64) / scale
    image = themap.satellite.width, themap.satellite.height
    return _around(np.array(centre), spread, image, scale=scale)


def _around(
    centre: NDArray[np.float64], spread: NDArray[np.float64], image: tuple[int, int], *, scale: float
) -> View:
    """Cut a box of this spread out of the image; where it would stick out it moves in, or is smaller."""
    limit = np.array(image, dtype=np.float64)
    spread = np.minimum(np.maximum(np.floor(spread), 1), limit)
    left, top = np.floor(np.clip(centre - spread / 2, 0, limit - spread))
    return View(int(left), int(top), int(left + spread[0]), int(top + spread[1]), scale)


def ground(satellite: NDArray[np.uint8], themap: Map, *, view: View) -> NDArray[np.uint8]:
    """Cut a view out of the satellite image, with its colours held back.

    Parameters
    ----------
    satellite : (height, width, 3) uint8
        Blue, green, red. It may have another size than the map states: positions follow the stated one.
    themap : Map
    view : View

    Returns
    -------
    (height, width, 3) uint8
        Red, green, blue.
    """
    height, width = satellite.shape[:2]
    sx, sy = width / themap.satellite.width, height / themap.satellite.height
    columns = slice(int(view.left * sx), max(int(view.left * sx) + 1, round(view.right * sx)))
    rows = slice(int(view.top * sy), max(int(view.top * sy) + 1, round(view.bottom * sy)))
    way = cv2.INTER_AREA if view.scale < 1 else cv2.INTER_CUBIC
    part = cv2.resize(satellite[rows, columns], view.size, interpolation=way)
    grey = cv2.cvtColor(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2RGB)
    colour = cv2.cvtColor(part, cv2.COLOR_BGR2RGB)
    return np.asarray(cv2.addWeighted(colour, 0.6, grey, 0.4, 0), dtype=np.uint8)


def scale_bar(themap: Map, view: View) -> tuple[float, str]:
    """Length in the picture and label of a round distance, at most 120 pixels long."""
    middle = MapPixel((view.left + view.right) / 2, (view.top + view.bottom) / 2)
    unit_px, unit = view.scale, "map pixels"
    if themap.georeference is not None:
        metres = themap.georeference.metres_per_pixel(middle)
        if math.isfinite(metres) and metres > 0:
            unit_px, unit = view.scale / metres, "m"
    power = 10.0 ** math.floor(math.log10(120 / unit_px))
    amount = max(step * power for step in (1, 2, 5) if step * power * unit_px <= 120)
    return amount * unit_px, f"{amount:g} {unit}"
