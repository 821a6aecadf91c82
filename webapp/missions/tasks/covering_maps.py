"""Finds maps whose images cover the area of a mission, for its background."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sqlalchemy.orm import Session

from webapp.missions.store import tracks
from webapp.missions.store.schema import Mission
from webapp.store.maps import maps
from webapp.store.schema import Account, MapRecord
from webapp.tasks.maps.library_map import georeference

_MOST = 10


class MapBox(NamedTuple):
    """Sides of the image of a map, degrees."""

    south: float
    west: float
    north: float
    east: float


def covering_maps(session: Session, mission: Mission, *, account: Account) -> list[MapRecord]:
    """List other maps that an account may see and whose images overlap a mission, last changed first."""
    wanted = _extent(session, mission)
    if wanted is None:
        return []
    others = (one for one in maps.list_maps(session, account) if one.id != mission.map_id)
    return [one for one in others if _meets(image_box(one), wanted)][:_MOST]


def _extent(session: Session, mission: Mission) -> MapBox | None:
    """Return the bounding box of all tracks, else the start position; None if neither is known."""
    known = [one for one in tracks.list_tracks(session, mission.id) if one.min_lat is not None]
    if known:
        sides = [(one.min_lat, one.min_lon, one.max_lat, one.max_lon) for one in known]
        table = np.array(sides, np.float64)
        return MapBox(*table[:, :2].min(0).tolist(), *table[:, 2:].max(0).tolist())
    if mission.start is None:
        return None
    lat, lon = mission.start["lat"], mission.start["lon"]
    return MapBox(lat, lon, lat, lon)


def image_box(record: MapRecord) -> MapBox | None:
    """Return the box around the image of a map; None without a georeferenced image."""
    where, width, height = georeference(record), record.satellite_width, record.satellite_height
    if where is None or not width or not height:
        return None
    corners = where.latlon_from_pixel([[0, 0], [width, 0], [width, height], [0, height]])
    if not np.isfinite(corners).all():
        return None
    return MapBox(*corners.min(0).tolist(), *corners.max(0).tolist())


def _meets(image: MapBox | None, wanted: MapBox) -> bool:
    if image is None:
        return False
    across = image.south <= wanted.north and image.north >= wanted.south
    return across and image.west <= wanted.east and image.east >= wanted.west
