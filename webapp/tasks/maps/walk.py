"""The walk through the placed photos of a map, from its records."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.walk import Stop, Walk, plan_walk
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import floors, georeference

_KEPT = 8
"""Maps whose walk is kept in memory: that of 10 000 photos takes seconds."""


def walk_of(session: Session, record: MapRecord) -> Walk:
    """Plan the walk through the placed photos of a map."""
    columns = (
        Photo.id,
        Photo.x_px,
        Photo.y_px,
        Photo.floor,
        Photo.heading_deg,
        Photo.taken_at,
        Photo.name,
        Photo.panorama,
    )
    placed = (Photo.map_id == record.id, ~Photo.removed, Photo.x_px.is_not(None))
    rows = session.execute(select(*columns).where(*placed).order_by(Photo.id)).all()
    levels = {floor.id: floor.level for floor in floors(record)}
    ground = _on_the_ground(georeference(record), np.array([row[1:3] for row in rows]).reshape(-1, 2))
    return _planned(
        tuple(
            Stop(id, east, north, floor, levels.get(floor, 0.0), heading, taken_at, name, sphere is not None)
            for (id, _, _, floor, heading, taken_at, name, sphere), (east, north) in zip(
                rows, ground.tolist(), strict=True
            )
        )
    )


def walk_of_map(map_: Map) -> Walk:
    """Plan the walk through the placed photos of a map that was read from files."""
    levels = {floor.id: floor.level for floor in map_.floors}
    pixels = np.array([e.position for e in map_.experiences], np.float64).reshape(-1, 2)
    ground = _on_the_ground(map_.georeference, pixels).tolist()
    return plan_walk(
        [
            Stop(
                *(e.id, east, north, e.floor, levels.get(e.floor, 0.0), e.heading_deg, e.taken_at),
                name=e.name or e.photo,
                all_around=e.panorama is not None,
            )
            for e, (east, north) in zip(map_.experiences, ground, strict=True)
        ]
    )


@lru_cache(_KEPT)
def _planned(stops: tuple[Stop, ...]) -> Walk:
    return plan_walk(stops)


def _on_the_ground(found: Georeference | None, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return east and north of map pixels: metres, or pixels where the georeference is undefined."""
    if found is not None and len(pixels):
        latlon = found.latlon_from_pixel(pixels)
        if np.isfinite(latlon).all():
            return LocalFrame(centre_of(latlon)).enu_from_latlon(latlon)
    return pixels * (1.0, -1.0)
