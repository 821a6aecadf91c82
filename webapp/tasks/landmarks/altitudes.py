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
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.landmarks.known import AnyPhoto

_FILE = "altitudes.json"
"""Next to the features of photos: by content hash."""

_KEPT_EACH = 200
"""Photos after which what was read is stored."""

_HIGHEST_M = 20_000.0
"""Altitudes, up or down, from which on they are not those of a camera."""


def read_altitudes(
    cfg: Path,
    photos: Mapping[str, AnyPhoto],
    *,
    folder: Path,
    limits: PhotoLimits,
    progress: Progress,
) -> dict[str, Altitude]:
    """Read the altitudes of photos, by content; each file is read once only.

    That takes a while for many large photos, as files are checked for damage.

    Args:
        photos: By content. The views of a panorama share its file.
        folder: Folder of the photos' features.
    """
    known = _stored(folder)
    missing = sorted(photos.keys() - known.keys(), key=lambda content: photos[content].photo)
    if missing:
        progress.note("reading photos")
    last, read = "", None
    for count, content in enumerate(missing, 1):
        progress.check()
        if photos[content].photo != last:
            last = photos[content].photo
            read = _read(cfg, photos[content], limits=limits)
        if read is not None:
            known[content] = read
        if count % _KEPT_EACH == 0 or count == len(missing):
            write_text(folder / _FILE, json.dumps({one: asdict(its) for one, its in known.items()}))
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
