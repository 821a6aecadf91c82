"""Converts between the records of the library and the map model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.model import (
    FACTS,
    Experience,
    Map,
    MapPhoto,
    Placement,
    SatelliteImage,
    UnplacedPhoto,
)
from webapp.core.mapmodel.notes import MapNote
from webapp.files.json_fields import JsonField
from webapp.files.maps.facts import fact_fields, from_json
from webapp.files.maps.lists import LISTS
from webapp.files.maps.map_json import parse_georeference
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere

_SAME_PX = 1.0
"""A photo within this distance of its GPS position counts as placed by GPS."""


def as_map(session: Session, record: MapRecord) -> Map | None:
    """Build the map model from the records; None if there is no satellite image yet."""
    if record.satellite_path is None or not record.satellite_width or not record.satellite_height:
        return None
    photos = [p for p in maps.photos(session, record) if not p.removed]
    by_gps = placed_by_gps(photos, georeference(record))
    experiences = tuple(e for p in photos if (e := experience_of(p, by_gps=p.id in by_gps)) is not None)
    return Map(
        satellite=SatelliteImage(record.satellite_path, record.satellite_width, record.satellite_height),
        experiences=experiences,
        georeference=georeference(record),
        placements=_placements(session, record, ids={e.id for e in experiences}),
        next_id=record.next_id,
        revision=record.revision,
        title=record.name,
        description=record.description,
        unplaced=tuple(_unplaced(p) for p in photos if p.x_px is None),
        **{name: _listed(record, name) for name in LISTS},
    )


def georeference(record: MapRecord) -> Georeference | None:
    return parse_georeference(record.georeference, where=record.slug)


def control_points(record: MapRecord) -> tuple[GroundControlPoint, ...]:
    return _listed(record, "control_points")


def notes(record: MapRecord) -> tuple[MapNote, ...]:
    return _listed(record, "notes")


def floors(record: MapRecord) -> tuple[Floor, ...]:
    return _listed(record, "floors")


def _listed(record: MapRecord, name: str) -> tuple[Any, ...]:
    return LISTS[name].parse(JsonField(getattr(record, name), f"$.{name}", record.slug))


def placed_by_gps(photos: Iterable[Photo], georeference: Georeference | None) -> set[int]:
    """Return the ids of photos at their GPS positions; all others were placed deliberately."""
    known = [
        p
        for p in photos
        if p.x_px is not None and p.gps_lat is not None and p.gps_lon is not None and p.radius_px is None
    ]
    if georeference is None or not known:
        return set()
    at = np.array([[p.x_px, p.y_px] for p in known], np.float64)
    latlon = np.array([[p.gps_lat, p.gps_lon] for p in known], np.float64)
    off = np.abs(georeference.pixel_from_latlon(latlon) - at).max(1)
    return {p.id for p, away in zip(known, off.tolist(), strict=True) if away <= _SAME_PX}


def experience_of(photo: Photo, *, by_gps: bool) -> Experience | None:
    """Convert a photo; None for one in the tray."""
    if photo.x_px is None or photo.y_px is None:
        return None
    return Experience(
        id=photo.id,
        photo=photo.path,
        position=MapPixel(photo.x_px, photo.y_px),
        **_facts(photo),
        by_gps=by_gps,
        radius_px=photo.radius_px,
        floor=photo.floor,
    )


def _unplaced(photo: Photo) -> UnplacedPhoto:
    lat, lon = photo.gps_lat, photo.gps_lon
    gps = None if lat is None or lon is None else LatLon(lat, lon)
    return UnplacedPhoto(photo.id, photo.path, gps=gps, **_facts(photo))


def _facts(photo: Photo) -> dict[str, Any]:
    facts = {
        name: from_json(fact.form, getattr(photo, name), where=photo.path) for name, fact in FACTS.items()
    }
    return {**facts, "name": photo.name if photo.name != PurePosixPath(photo.path).name else None}


def fact_columns(photo: MapPhoto) -> dict[str, Any]:
    return {**fact_fields(photo), "name": photo.name or PurePosixPath(photo.photo).name}


def _placements(session: Session, record: MapRecord, *, ids: set[int]) -> tuple[Placement, ...]:
    """Collect the further placements, without photos that have no position in the main one."""
    found = select(PlacedElsewhere).where(PlacedElsewhere.map_id == record.id)
    positions: dict[str, dict[int, MapPixel]] = defaultdict(dict)
    for row in session.scalars(found.order_by(PlacedElsewhere.placement, PlacedElsewhere.photo_id)):
        if row.photo_id in ids:
            positions[row.placement][row.photo_id] = MapPixel(row.x_px, row.y_px)
    return tuple(Placement(name, at) for name, at in positions.items())
