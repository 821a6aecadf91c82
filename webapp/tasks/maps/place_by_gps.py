"""Places the photos in the tray by the GPS position that they came with."""

from __future__ import annotations

from webapp.core.geo.types import LatLon
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.placing import Placing, Wanted, find_spots, needed_image, place_spots


def run(library: Library, map_id: int, *, account_id: int) -> Placing:
    """Place every photo that has no place yet and a GPS position on the image, as one edit.

    Parameters
    ----------
    library : Library
    map_id : int
    account_id : int
        Who does it, and can undo it.

    Returns
    -------
    Placing

    Raises
    ------
    UsageError
        The map has no satellite image, or that no georeference.
    """
    with library.database.write() as session:
        record = session.get_one(MapRecord, map_id, with_for_update=True)
        image = needed_image(record, with_georeference=True)
        wanted = [
            Wanted(photo, LatLon(photo.gps_lat, photo.gps_lon))
            for photo in maps.photos(session, record)
            if not photo.removed
            and photo.x_px is None
            and photo.gps_lat is not None
            and photo.gps_lon is not None
        ]
        spots = find_spots(image, wanted)
        return place_spots(session, record, spots=spots, kind="place-gps", account_id=account_id)
