"""Writes GeoJSON (RFC 7946; longitude before latitude) as a stream, and reads its coordinate system."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any

from webapp.core.geo.crs import parse_crs
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.model import WRITTEN, Experience, Map
from webapp.core.mapmodel.notes import MapNote
from webapp.errors import GeoreferenceError, InputError

_CRS = re.compile(
    r"(?:urn:(?:x-)?ogc:def:crs:|https?://www\.opengis\.net/(?:def/crs/|gml/srs/)|)"
    r"(?:(epsg|ogc|esri|ignf)(?:\.xml)?[:/#](?:[\w.]*[:/])?)?(\w+)",
    re.IGNORECASE,
)
"""`EPSG:25833`, `urn:ogc:def:crs:EPSG::25833`, `http://www.opengis.net/def/crs/EPSG/0/25833`, `25833` ..."""

_WGS84 = {"EPSG:4326", "EPSG:4979", "OGC:CRS84", "OGC:CRS84H", "CRS84", "CRS84H", "WGS84"}

_NAMED_BY = ("name", "code", "urn", "href")
"""Properties of a `crs`, of any type, that name it."""

EXPORT_WGS84 = "export it in WGS 84 (EPSG:4326)"
NO_PLANE = "the coordinates, such as {}, are beyond degrees, and the file states no coordinate system"
_DIGITS = 9
"""Decimals of degrees: a tenth of a millimetre."""


def stated_plane(holder: Any, usual: str | None = None, *, error: type[InputError]) -> str | None:
    """Return the coordinate system of a document, a feature or a geometry, from `crs`; None for WGS 84.

    Args:
        usual: That of what holds it.
        error: Raised if it has one that is not known.
    """
    given = holder.get("crs") if isinstance(holder, dict) else None
    if not isinstance(given, dict):
        return usual
    about = given.get("properties")
    about = about if isinstance(about, dict) else {}
    named = str(next(filter(None, map(about.get, _NAMED_BY)), given.get("type")))
    found = _CRS.fullmatch(named.strip().replace("WGS 84", "WGS84"))
    usual_authority = "EPSG" if found and found[2].isdecimal() else ""
    code = f"{found[1] or usual_authority}:{found[2]}".strip(":").upper() if found else named
    if code in _WGS84:
        return None
    try:
        parse_crs(code)
    except GeoreferenceError as problem:
        message = f"the coordinate system {named[:80]!r} is not known"
        raise error(message, where="crs", hint=EXPORT_WGS84) from problem
    return code


def is_beyond_degrees(x: float, y: float) -> bool:
    """Return whether a position is so far outside degrees that it must be in metres."""
    return abs(x) > 360.0 or abs(y) > 180.0


def format_geojson(map_: Map, georeference: Georeference, *, title: str) -> Iterator[bytes]:
    """Write the photos and notes of a map as points.

    Yields:
        UTF-8. Unknown values are null, as is the geometry of a position without latitude and longitude.
    """
    photos = ([_photo(e, georeference, map_)] for e in map_.experiences)
    return write_collection(title, chain(photos, ([_note(note, map_, georeference)] for note in map_.notes)))


def write_collection(name: str, features: Iterable[Iterable[str]]) -> Iterator[bytes]:
    """Write a feature collection.

    Yields:
        UTF-8.
    """
    yield f'{{"type":"FeatureCollection","name":{to_json(name)},"features":['.encode("utf-8", "replace")
    for number, feature in enumerate(features):
        yield b",\n" if number else b"\n"
        for part in feature:
            yield part.encode("utf-8", "replace")
    yield b"\n]}\n"


def point_feature(
    id_: int | str, latlon: LatLon | None, *, properties: Mapping[str, object], height_m: float | None = None
) -> str:
    """Write a point; its geometry is null without a position."""
    geometry = None
    if latlon is not None:
        position = [round(latlon.lon, _DIGITS), round(latlon.lat, _DIGITS)]
        if height_m is not None:
            position.append(height_m)
        geometry = {"type": "Point", "coordinates": position}
    return to_json({"type": "Feature", "id": id_, "geometry": geometry, "properties": properties})


def to_json(value: object) -> str:
    """Write a value without white space; NaN and infinite numbers raise ValueError."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def photo_properties(e: Experience) -> dict[str, object]:
    """Return the properties of a photo, None where unknown; KML uses the same names."""
    return {
        "photo": e.photo,
        "x_px": e.position.x,
        "y_px": e.position.y,
        "heading_deg": e.heading_deg,
        "fov_deg": e.fov_deg,
        "gps_accuracy_m": e.gps_accuracy_m,
        "radius_px": e.radius_px,
        "taken_at": e.taken_at,
        "credit": None if e.source is None else e.source.credit,
        **{name: getattr(e, name) for name in WRITTEN},
    }


def _photo(e: Experience, georeference: Georeference, map_: Map) -> str:
    on = floor_properties(map_, e.floor)
    return point_feature(e.id, _latlon(e.position, georeference), properties={**photo_properties(e), **on})


def floor_properties(map_: Map, id: int) -> dict[str, Any]:
    """Return a floor's name as `floor`, and its `level`; empty if the map does not have it."""
    floor = map_.floor_named(id)
    return {} if floor is None else {"floor": floor.name, "level": floor.level}


def _note(note: MapNote, map_: Map, georeference: Georeference) -> str:
    at = None if note.position is None else _latlon(note.position, georeference)
    about = {"title": note.title, "note": note.text or None, "photos": list(note.photos)}
    properties = about | floor_properties(map_, note.floor)
    return point_feature(f"note-{note.id}", at, properties=properties)


def _latlon(position: MapPixel, georeference: Georeference) -> LatLon | None:
    found = georeference.latlon_of(position)
    return found if math.isfinite(found.lat) and math.isfinite(found.lon) else None
