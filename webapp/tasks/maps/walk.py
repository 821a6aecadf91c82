"""The walk through the placed photos of a map, from its records."""

from __future__ import annotations

from functools import lru_cache
from threading import Lock

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
"""Maps whose walk is kept in memory: that of 10 000 photos takes a second."""
_LOCK = Lock()
"""Of the walks in memory, so that there is one of each map."""


def stops_of(session: Session, record: MapRecord) -> tuple[Stop, ...]:
    """Read the placed photos of a map, for `walk_along`."""
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
    return tuple(
        Stop(id, east, north, floor, levels.get(floor, 0.0), heading, taken_at, name, sphere is not None)
        for (id, _, _, floor, heading, taken_at, name, sphere), (east, north) in zip(
            rows, ground.tolist(), strict=True
        )
    )


def walk_along(stops: tuple[Stop, ...]) -> Walk:
    """Plan the walk through the photos of a map, once at a time for the same ones; not in a session."""
    with _LOCK:
        plan = _plan_of(stops)
    return plan.walk()


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


class _Plan:
    """The walk along some stops, planned when it is first needed."""

    def __init__(self, stops: tuple[Stop, ...]) -> None:
        self._stops = stops
        self._lock = Lock()
        self._walk: Walk | None = None

    def walk(self) -> Walk:
        with self._lock:
            if self._walk is None:
                self._walk = plan_walk(self._stops)
            return self._walk


_plan_of = lru_cache(_KEPT)(_Plan)


def _on_the_ground(found: Georeference | None, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return east and north of map pixels: metres, or pixels where the georeference is undefined."""
    if found is not None and len(pixels):
        latlon = found.latlon_from_pixel(pixels)
        if np.isfinite(latlon).all():
            return LocalFrame(centre_of(latlon)).enu_from_latlon(latlon)
    return pixels * (1.0, -1.0)
