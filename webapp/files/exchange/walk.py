"""A walk as GPX: waypoints, and a route that connects them in their order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from webapp.core.geo.types import LatLon
from webapp.files.exchange.gpx import NAMESPACE
from webapp.files.exchange.xml import DECLARATION, element


@dataclass(frozen=True, slots=True)
class WalkPoint:
    """A point of a walk."""

    name: str
    description: str  # What to do there
    latlon: LatLon
    heading_deg: float | None = None  # Where to look first, degrees clockwise from north


def format_walk_gpx(points: Sequence[WalkPoint], *, title: str) -> Iterator[bytes]:
    """Write a walk.

    Yields:
        UTF-8, GPX 1.1: each point as a waypoint and as a point of the only route.
    """
    for text in _pieces(points, title):
        yield text.encode("utf-8", "replace")


def _pieces(points: Sequence[WalkPoint], title: str) -> Iterator[str]:
    yield DECLARATION
    yield (
        '<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1" '
        f'xmlns:e="{NAMESPACE}">\n<metadata>{element("name", title)}</metadata>\n'
    )
    yield from (_point("wpt", point) for point in points)
    yield f"<rte>{element('name', title)}\n"
    yield from (_point("rtept", point) for point in points)
    yield "</rte>\n</gpx>\n"


def _point(tag: str, point: WalkPoint) -> str:
    inner = element("name", point.name) + element("desc", point.description)
    if point.heading_deg is not None:
        inner += f"<extensions><e:heading>{point.heading_deg:.0f}</e:heading></extensions>"
    return f'<{tag} lat="{point.latlon.lat:.7f}" lon="{point.latlon.lon:.7f}">{inner}</{tag}>\n'
