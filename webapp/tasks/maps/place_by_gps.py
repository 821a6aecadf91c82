"""Places the photos in the tray by the GPS position that they came with."""

from __future__ import annotations

from dataclasses import replace

from webapp.core.geo.types import LatLon
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.tasks.maps.placing import Placing, Wanted, find_spots, needed_image, place_spots


def place_by_gps(library: Library, map_id: int, *, account_id: int) -> Placing:
    """Place every photo that has no place yet and a GPS position on the image, as one edit.

    Parameters
    ----------
    account_id : int
        Who does it, and can undo it.

    Raises
    ------
    UsageError
        The map has no satellite image, or that no georeference.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
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
        placing = place_spots(session, record, spots=spots, kind="place-gps", account_id=account_id)
    return replace(placing, job=change.job)
