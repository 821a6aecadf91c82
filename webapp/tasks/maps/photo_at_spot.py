"""Takes photos of planned spots into a map; where they have no GPS, the spot is suggested as their place."""

from __future__ import annotations

from dataclasses import dataclass

from webapp.core.geo.types import MapPixel
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.place_rest import SuggestedPlace
from webapp.tasks.maps.add_photo import IncomingPhoto, Intake, add_photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.placing import needed_image

_ACCURACY_M = 10.0
"""How near to a spot people come who are led there by the GPS of a phone."""

_OF_IMAGE = 0.02
"""The same as a share of the image's longer side, where it has no georeference."""


@dataclass(frozen=True, slots=True)
class TargetPose:
    """Where a photo was to be taken, and where the camera was to look."""

    position: MapPixel
    heading_deg: float | None = None


def add_photo_at_spot(
    library: Library, map_id: int, *, photo: IncomingPhoto, pose: TargetPose, settings: Settings
) -> tuple[Intake, bool]:
    """Take a photo into a map, as `add_photo`.

    Returns
    -------
    intake : Intake
    suggested : bool
        It waits in the tray, and the spot is suggested as its place.

    Raises
    ------
    PhotoError, NotFound, UsageError, DiskFull, StorageError
    """
    intake = add_photo(library, map_id, photo=photo, settings=settings)
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        row = maps.photo(session, record, intake.id)
        if row.x_px is not None or row.gps_lat is not None or record.satellite_path is None:
            return intake, False
        place = SuggestedPlace(
            row.id, row.path, pose.position, _radius_px(record, pose.position), pose.heading_deg, ()
        )
        cfg, revision = library.cfg(record.slug), record.revision
    stored.suggest(cfg, place, revision=revision)
    return intake, True


def _radius_px(record: MapRecord, position: MapPixel) -> float:
    image = needed_image(record, with_georeference=False)
    where = georeference(record)
    if where is None:
        return _OF_IMAGE * max(image.width, image.height)
    return _ACCURACY_M / where.metres_per_pixel(position)
