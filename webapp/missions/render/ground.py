"""The image of a mission's map, in the projection of slippy maps."""

from __future__ import annotations

from webapp.missions.store.schema import Mission
from webapp.render.mercator import MercatorPicture, to_mercator
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.exchange.export_source import Source, of_library, satellite_picture

_IMAGE_SIDE = 4096


def ground_of(library: Library, mission_id: int, *, settings: Settings) -> MercatorPicture | None:
    """Reproject the image of the mission's map to Mercator; None if it cannot be placed."""
    with library.database.read() as session:
        map_id = session.get_one(Mission, mission_id).map_id
        record = None if map_id is None else session.get_one(MapRecord, map_id)
        if record is None or record.satellite_path is None or record.georeference is None:
            return None
    source: Source = of_library(library, record.id)
    satellite = source.map.satellite
    picture = satellite_picture(source.cfg, satellite.path, side=_IMAGE_SIDE, settings=settings)
    if picture is None:
        return None
    return to_mercator(picture, source.georeference(), size=(satellite.width, satellite.height))
