"""Which points a GeoJSON geometry has: the parameter `intersects` of a STAC search."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.connect.gis.ogc_query import Region
from webapp.errors import UsageError

MOST_CORNERS = 2000
_PARTS = {"MultiPoint": "Point", "MultiLineString": "LineString", "MultiPolygon": "Polygon"}
_HINT = "send a GeoJSON geometry, such as a Polygon: lists of [longitude, latitude]"
_ON_LINE_DEG = 1e-9
"""Distance of a point that is on a line: a tenth of a millimetre."""

Floats = NDArray[np.float64]


def parse_region(geometry: Any) -> Region:
    """Parse a GeoJSON geometry.

    Raises:
        UsageError: It is none, or has too many corners.
    """
    parts = list(_parts(geometry, depth=0))
    if sum(len(ring) for _, rings in parts for ring in rings) > MOST_CORNERS:
        raise UsageError(
            "the geometry has too many corners", where="intersects", hint=f"use at most {MOST_CORNERS}"
        )

    def has(lat: Floats, lon: Floats) -> NDArray[np.bool_]:
        found = np.zeros(lat.shape, np.bool_)
        for is_area, rings in parts:
            on_line = [_on_line(ring, lat=lat, lon=lon) for ring in rings]
            found |= np.any(on_line, axis=0)
            if is_area:  # holes are rings, too: the rule is even-odd
                found |= np.bitwise_xor.reduce([_inside(ring, lat=lat, lon=lon) for ring in rings], axis=0)
        return found

    return has


def _parts(geometry: Any, *, depth: int) -> Iterator[tuple[bool, list[Floats]]]:
    """Yield points, lines and areas: whether it is an area, and its rings (n, 2)."""
    if not isinstance(geometry, dict) or depth > 2:
        raise UsageError("this is no geometry", where="intersects", hint=_HINT)
    kind, inner = geometry.get("type"), geometry.get("coordinates")
    if kind == "GeometryCollection" and isinstance(members := geometry.get("geometries"), list):
        for member in members[:MOST_CORNERS]:
            yield from _parts(member, depth=depth + 1)
    elif kind in _PARTS and isinstance(inner, list):
        for one in inner[: MOST_CORNERS + 1]:
            yield from _parts({"type": _PARTS[str(kind)], "coordinates": one}, depth=depth + 1)
    elif kind == "Point":
        yield False, [_corners([inner], least=1)]
    elif kind == "LineString":
        yield False, [_corners(inner, least=2)]
    elif kind == "Polygon" and isinstance(inner, list) and inner:
        yield True, [_corners(ring, least=4) for ring in inner[: MOST_CORNERS + 1]]
    else:
        raise UsageError("this is no geometry", where="intersects", hint=_HINT)


def _corners(given: Any, *, least: int) -> Floats:
    is_list = isinstance(given, list) and least <= len(given) <= MOST_CORNERS
    if not is_list or not all(
        isinstance(one, list) and 2 <= len(one) <= 3 and _numbers(one) for one in given
    ):
        raise UsageError("a part of the geometry is not valid", where="intersects", hint=_HINT)
    return np.array([one[:2] for one in given], np.float64)


def _numbers(values: list[Any]) -> bool:
    plain = all(isinstance(one, int | float) and not isinstance(one, bool) for one in values)
    return plain and all(abs(one) <= 1e6 and math.isfinite(one) for one in values)


def _inside(ring: Floats, *, lat: Floats, lon: Floats) -> NDArray[np.bool_]:
    """Return whether a ray to the east from each point crosses a ring an odd number of times."""
    odd = np.zeros(lat.shape, np.bool_)
    for (x1, y1), (x2, y2) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        if y1 != y2:
            crosses = (y1 > lat) != (y2 > lat)
            odd ^= crosses & (lon < x1 + (lat - y1) * (x2 - x1) / (y2 - y1))
    return odd


def _on_line(corners: Floats, *, lat: Floats, lon: Floats) -> NDArray[np.bool_]:
    found = np.zeros(lat.shape, np.bool_)
    ends = corners[1:] if len(corners) > 1 else corners
    for (x1, y1), (x2, y2) in zip(corners, ends, strict=False):
        dx, dy = x2 - x1, y2 - y1
        length2 = dx * dx + dy * dy
        along = np.clip(((lon - x1) * dx + (lat - y1) * dy) / length2, 0.0, 1.0) if length2 else 0.0
        found |= np.hypot(lon - x1 - along * dx, lat - y1 - along * dy) <= _ON_LINE_DEG
    return found
