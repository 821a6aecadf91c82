"""The altitudes in the metadata of a map's photos, kept next to their features."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from webapp.core.geo.types import MapPixel
from webapp.core.landmarks.heights import Altitude, Altitudes
from webapp.core.mapmodel.model import Map
from webapp.errors import PhotoError
from webapp.files.atomic import write_text
from webapp.files.maps.folder import photo_path
from webapp.files.photos.exif import Gps
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits
from webapp.tasks.landmarks.known import AnyPhoto

_FILE = "altitudes.json"
"""Next to the features of photos: by content hash."""

_HIGHEST_M = 20_000.0
"""Altitudes, up or down, from which on they are not those of a camera."""


def read_altitudes(
    cfg: Path, photos: Mapping[str, AnyPhoto], *, folder: Path, limits: PhotoLimits
) -> dict[str, Altitude]:
    """Read the altitudes of photos, by content; the header of each file is read once only.

    Args:
        photos: By content.
        folder: Folder of the photos' features.
    """
    known = _stored(folder)
    read = {content: _read(cfg, photos[content], limits=limits) for content in photos.keys() - known.keys()}
    new = {content: one for content, one in read.items() if one is not None}
    known |= new
    if new:
        write_text(folder / _FILE, json.dumps({content: asdict(one) for content, one in known.items()}))
    return {content: known[content] for content in photos.keys() & known.keys()}


def _read(cfg: Path, photo: AnyPhoto, *, limits: PhotoLimits) -> Altitude | None:
    try:
        gps = read_facts(photo_path(cfg, photo.photo), limits=limits).gps
    except PhotoError:  # it was changed since it was described, which the next run reports
        return None
    if not isinstance(gps, Gps):
        return Altitude()
    return Altitude(_plausible(gps.altitude_m), _plausible(gps.relative_altitude_m))


def _plausible(metres: float | None) -> float | None:
    return metres if metres is not None and abs(metres) < _HIGHEST_M else None


def known_altitudes(altitude_of: Mapping[int, Altitude], the_map: Map, *, count: int) -> Altitudes | None:
    """Collect the altitudes of `count` photos; None without a georeference, which gives the scale.

    Args:
        altitude_of: By the photos' numbers.
    """
    georeference, image = the_map.georeference, the_map.satellite
    if georeference is None:
        return None
    metres = georeference.metres_per_pixel(MapPixel(image.width / 2, image.height / 2))
    if not 0.0 < metres < math.inf:
        return None
    return Altitudes(tuple(altitude_of.get(number, Altitude()) for number in range(count)), 1.0 / metres)


def _stored(folder: Path) -> dict[str, Altitude]:
    """Read what was read before; nothing if the file is missing or damaged, as it can be read again."""
    try:
        stored = json.loads((folder / _FILE).read_text("utf-8"))
        return {content: Altitude(**one) for content, one in stored.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
