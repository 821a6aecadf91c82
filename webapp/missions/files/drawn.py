"""Drawings of a mission in files that this program exported: the property `drawing` names their kind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from webapp.core import texts
from webapp.errors import UsageError
from webapp.files.exchange.times import utc_or_none
from webapp.missions.core.drawings import (
    KINDS,
    LEAST_RADIUS_M,
    MAX_NAME,
    MAX_NOTE,
    MOST_RADIUS_M,
    RADIUS_M,
    Kind,
    checked_points,
)
from webapp.missions.core.trajectory.outgoing import ExportDrawing

GEOMETRIES = {"area": "Polygon", "line": "LineString", "marker": "Point"}
"""Types of GeoJSON and elements of KML."""


@dataclass(frozen=True, slots=True)
class FoundDrawing:
    """A valid drawing in a file; who has drawn and searched it is not taken over."""

    kind: Kind
    name: str
    points: tuple[tuple[float, float], ...]  # Degrees north, degrees east
    note: str = ""
    assigned: str = ""
    radius_m: float | None = None  # None except of areas
    searched: bool = False

    def fields(self) -> dict[str, Any]:
        """Return what the store takes; the last three belong to areas only."""
        found: dict[str, Any] = {"name": self.name, "note": self.note, "points": list(self.points)}
        if self.kind == "area":
            found |= {"assigned": self.assigned, "radius_m": self.radius_m, "searched": self.searched}
        return found


def kind_of_drawing(properties: Mapping[str, Any]) -> Kind | None:
    """Return the kind of a drawing; None for anything else in a file."""
    return next((kind for kind in KINDS if kind == properties.get("drawing")), None)


def found_drawing(
    kind: Kind, properties: Mapping[str, Any], *, points: list[tuple[float, float]]
) -> FoundDrawing | None:
    """Return a drawing of a file; None if its shape is invalid. Invalid texts and radii are left out."""
    try:
        shape = tuple(checked_points(kind, points))
    except UsageError:
        return None
    name = texts.tidy_name(str(properties.get("name") or kind), most=MAX_NAME) or kind
    note = str(properties.get("note") or "")
    if len(note) > MAX_NOTE or texts.has_controls(note, besides="\n\r\t"):
        note = ""
    if kind != "area":
        return FoundDrawing(kind, name, shape, note)
    assigned = texts.tidy_name(str(properties.get("assigned") or ""), most=MAX_NAME) or ""
    searched = properties.get("searched") in (True, "true")
    return FoundDrawing(kind, name, shape, note, assigned, _radius(properties.get("radius_m")), searched)


def turned_lon(lon: float) -> float:
    """Return a longitude from -180 to 180: outlines across the 180th meridian are written without a jump."""
    return lon if -180.0 <= lon <= 180.0 else math.remainder(lon, 360.0)


def continuous(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return points whose longitudes do not jump at the 180th meridian, where they exceed 180."""
    lons = np.unwrap([lon for _, lon in points], period=360.0).tolist()
    return [(lat, lon) for (lat, _), lon in zip(points, lons, strict=True)]


def _radius(value: object) -> float:
    try:
        radius = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return RADIUS_M
    return radius if LEAST_RADIUS_M <= radius <= MOST_RADIUS_M else RADIUS_M


def drawing_facts(drawing: ExportDrawing) -> dict[str, object]:
    """Return the properties of an exported drawing, None where unknown."""
    return {
        "drawing": drawing.kind,
        "name": drawing.name,
        "note": drawing.note or None,
        "assigned": drawing.assigned or None,
        "radius_m": drawing.radius_m,
        "searched": drawing.searched,
        "searched_time": utc_or_none(drawing.searched_time_s),
        "searched_by": drawing.searched_by,
        "created_time": utc_or_none(drawing.created_time_s),
        "created_by": drawing.created_by,
    }
