"""Where photos come when a map gets another image, or another georeference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.positions import inside
from webapp.store.schema import Photo
from webapp.tasks.maps.place_photos import MapImage

_SAME_PX = 1e-6
"""Rounding, and no move."""

_AT_GPS_PX = 0.01
"""A photo so close to where its GPS says was put there by it."""

_SAME_DEG = 0.05

TRAY: dict[str, Any] = {"x_px": None, "y_px": None}


@dataclass(frozen=True, slots=True)
class ImageChange:
    """From one image to the next.

    With another image of which both are georeferenced, photos keep their place on the Earth. Else they keep
    their pixels, or grow with the image. With another georeference of the same image, photos that stand where
    their GPS says go along with the Earth; all others stay on the image, and so do their arrows.

    Attributes
    ----------
    same_file : bool
        Whether it is the same image, with another georeference.
    scale : bool
        Whether positions grow with the image.
    """

    old: MapImage | None
    new: MapImage
    same_file: bool
    scale: bool = False

    def moved(self, positions: Sequence[MapPixel]) -> list[MapPixel]:
        """Give the places on the new image; NaN where there is none."""
        if not positions or self.old is None or self.same_file:
            return list(positions)
        before, after = self.old.georeference, self.new.georeference
        pixels = np.asarray(positions, dtype=np.float64)
        if before is not None and after is not None:
            pixels = after.pixel_from_latlon(before.latlon_from_pixel(pixels))
        elif self.scale:
            pixels = pixels * (self.new.width / self.old.width, self.new.height / self.old.height)
        return [
            self._tidy(MapPixel(*after), before=before)
            for after, before in zip(pixels.tolist(), positions, strict=True)
        ]

    def on_it(self, position: MapPixel) -> bool:
        """Return whether a place is on the new image."""
        return inside(position, width=self.new.width, height=self.new.height)

    def placed(self, photo: Photo, at: MapPixel) -> dict[str, Any]:
        """Give the fields of a photo that was placed and comes to `at`, were it not for its GPS."""
        before = _position(photo)
        gps = _gps(photo)
        if not self.same_file or self.old is None:
            return {"x_px": at.x, "y_px": at.y}
        if gps is not None and _stands_at(before, gps, self.old):
            there = self.new.georeference.pixel_of(gps) if self.new.georeference else before
            at = self._tidy(there, before=before)
            return {"x_px": at.x, "y_px": at.y}
        fields: dict[str, Any] = {"x_px": at.x, "y_px": at.y}
        turn = _north(self.old, before) - _north(self.new, at)
        if photo.heading_deg is not None and abs(turn) > _SAME_DEG:
            fields["heading_deg"] = (photo.heading_deg + turn) % 360.0
        return fields

    def from_tray(self, photo: Photo) -> dict[str, Any] | None:
        """Give the place of a photo in the tray by its GPS, when the map gets its first georeference."""
        gps = _gps(photo)
        if gps is None or self.new.georeference is None:
            return None
        if self.old is not None and self.old.georeference is not None:
            return None
        at = self.new.georeference.pixel_of(gps)
        return {"x_px": at.x, "y_px": at.y} if self.on_it(at) else None

    def _tidy(self, after: MapPixel, *, before: MapPixel) -> MapPixel:
        """Take rounding away: what stays stays exactly, and what is on the border is not beyond it."""
        if math.dist(after, before) < _SAME_PX:
            return before
        inner = MapPixel(min(max(after.x, 0.0), self.new.width), min(max(after.y, 0.0), self.new.height))
        return inner if math.dist(after, inner) < _SAME_PX else after


def _position(photo: Photo) -> MapPixel:
    assert photo.x_px is not None
    assert photo.y_px is not None
    return MapPixel(photo.x_px, photo.y_px)


def _gps(photo: Photo) -> LatLon | None:
    if photo.gps_lat is None or photo.gps_lon is None:
        return None
    return LatLon(photo.gps_lat, photo.gps_lon)


def _stands_at(position: MapPixel, gps: LatLon, image: MapImage) -> bool:
    if image.georeference is None:
        return False
    return math.dist(image.georeference.pixel_of(gps), position) < _AT_GPS_PX


def _north(image: MapImage, at: MapPixel) -> float:
    """Direction of north in an image; up where that is not known."""
    if image.georeference is None:
        return 0.0
    north = image.georeference.north_deg(at)
    return north if math.isfinite(north) else 0.0
