"""Writes a map as GeoJSON (RFC 7946): a point a photo, longitude before latitude."""

from __future__ import annotations

import json
import math

from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.model import Experience, Map

_DIGITS = 9
"""Of degrees: a tenth of a millimetre."""


def format_geojson(map_: Map, georeference: Georeference, *, title: str) -> bytes:
    """Write the photos of a map as points.

    Parameters
    ----------
    map_ : Map
    georeference : Georeference
    title : str
        Name of the map.

    Returns
    -------
    bytes
        UTF-8. A photo whose place has no position on the Earth has no geometry. What is unknown is null.
    """
    content = {
        "type": "FeatureCollection",
        "name": title,
        "features": [_feature(e, georeference) for e in map_.experiences],
    }
    text = json.dumps(content, ensure_ascii=False, indent=1, allow_nan=False)
    return f"{text}\n".encode("utf-8", "replace")


def _feature(e: Experience, georeference: Georeference) -> dict[str, object]:
    lat, lon = georeference.latlon_of(e.position)
    known = math.isfinite(lat) and math.isfinite(lon)
    point = {"type": "Point", "coordinates": [round(lon, _DIGITS), round(lat, _DIGITS)]}
    return {
        "type": "Feature",
        "id": e.id,
        "geometry": point if known else None,
        "properties": {
            "photo": e.photo,
            "x_px": e.position.x,
            "y_px": e.position.y,
            "heading_deg": e.heading_deg,
            "fov_deg": e.fov_deg,
            "gps_accuracy_m": e.gps_accuracy_m,
            "taken_at": e.taken_at,
        },
    }
