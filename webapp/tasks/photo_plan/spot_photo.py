"""Adds photos of planned spots to a map; without GPS, the spot is suggested as their place."""

from __future__ import annotations

import math
from dataclasses import dataclass

from webapp.core.geo.types import MapPixel, inside
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.place_rest import SuggestedPlace
from webapp.tasks.maps.add_photo import AddedPhoto, IncomingPhoto, add_photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.placing import needed_image

_ACCURACY_M = 10.0
"""Accuracy with which people reach a spot by the GPS of a phone."""

_OF_IMAGE = 0.02
"""The same as a share of the image's longer side, if it has no georeference."""


@dataclass(frozen=True, slots=True)
class TargetPose:
    """Planned position and heading of a photo."""

    position: MapPixel
    heading_deg: float | None = None
    revision: int | None = None  # Revision of the map when the spot was planned; None for the current one


def add_photo_at_spot(
    library: Library, map_id: int, *, photo: IncomingPhoto, pose: TargetPose, settings: Settings
) -> tuple[AddedPhoto, bool]:
    """Add a photo to a map, as `add_photo`; without GPS, suggest the spot as its place.

    Raises PhotoError, NotFound, UsageError, DiskFull, StorageError.

    Returns:
        intake:
        suggested: It is in the tray, and the spot is suggested as its place; never if the image was replaced,
            or the spot is outside it.
    """
    intake = add_photo(library, map_id, photo=photo, settings=settings)
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        row = maps.photo(session, record, intake.id)
        if row.x_px is not None or row.gps_lat is not None or record.satellite_path is None:
            return intake, False
        radius = _radius_px(record, pose)
        if radius is None:
            return intake, False
        place = SuggestedPlace(row.id, row.path, pose.position, radius, pose.heading_deg, ())
        cfg, revision = library.cfg(record.slug), record.revision
    stored.suggest(cfg, place, revision=revision)
    return intake, True


def _radius_px(record: MapRecord, pose: TargetPose) -> float | None:
    """Return the radius around a spot that contains its photo; None if it is not on the current image."""
    image = needed_image(record, with_georeference=False)
    replaced = pose.revision is not None and pose.revision < record.satellite_revision
    if replaced or not inside(pose.position, width=image.width, height=image.height):
        return None
    where = georeference(record)
    if where is None:
        return _OF_IMAGE * max(image.width, image.height)
    scale = where.metres_per_pixel(pose.position)
    return _ACCURACY_M / scale if math.isfinite(scale) and scale > 0.0 else None
