"""Writes KML 2.3 as a stream: the elements that maps and missions share, and a map's photos.

Photos are placemarks with direction, time and picture. All text is escaped; see
https://docs.ogc.org/is/12-007r2/12-007r2.html for the order of elements.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.notes import MapNote
from webapp.files.exchange.geojson import floor_properties, photo_properties
from webapp.files.exchange.xml import DECLARATION, element, quoted

_OPEN = '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">\n'


@dataclass(frozen=True, slots=True)
class Pictures:
    # Path in the KMZ of the picture of each photo, by id.
    photos: Mapping[int, str] = field(default_factory=dict)
    ground: str | None = None  # Path in the KMZ of the satellite image


def format_kml(
    map_: Map, georeference: Georeference, *, title: str, pictures: Pictures | None = None
) -> Iterator[bytes]:
    """Write the photos and notes of a map as placemarks, with their floors as extended data.

    Yields:
        UTF-8. Photos and notes without latitude and longitude are left out.
    """
    pictures = pictures or Pictures()
    content = [element("name", title), "\n"]
    if pictures.ground is not None:
        content.append(_ground(map_, georeference, href=pictures.ground))
    marks = (_photo(e, map_, georeference, picture=pictures.photos.get(e.id)) for e in map_.experiences)
    notes = (_note(note, map_, georeference) for note in map_.notes)
    return write_kml(("<Document>", *content), marks, notes, ("</Document>\n",))


def write_kml(*parts: Iterable[str]) -> Iterator[bytes]:
    """Write a KML file with the given content.

    Yields:
        UTF-8.
    """
    yield (DECLARATION + _OPEN).encode()
    for part in parts:
        for text in part:
            yield text.encode("utf-8", "replace")
    yield b"</kml>\n"


def coordinates(at: LatLon, height_m: float | None = None) -> str:
    """Write longitude, latitude and perhaps height, to a tenth of a millimetre."""
    return f"{at.lon:.9f},{at.lat:.9f}" + ("" if height_m is None else f",{height_m:.3f}")


def point(at: LatLon, height_m: float | None = None) -> str:
    """Write the geometry of a placemark."""
    return f"<Point>{element('coordinates', coordinates(at, height_m))}</Point>"


def picture_description(href: str, *, caption: str = "") -> str:
    # a description is HTML inside XML, so it is escaped twice
    about = f"<p>{html.escape(caption)}</p>" if caption else ""
    return element("description", f'{about}<img src="{html.escape(href)}" alt="">')


def extended_data(facts: Mapping[str, object]) -> str:
    """Write named values; those that are None are left out."""
    data = "".join(
        f"<Data name={quoted(name)}>{element('value', value)}</Data>"
        for name, value in facts.items()
        if value is not None
    )
    return f"<ExtendedData>{data}</ExtendedData>"


def _photo(e: Experience, map_: Map, georeference: Georeference, *, picture: str | None) -> str:
    at = georeference.latlon_of(e.position)
    if not (math.isfinite(at.lat) and math.isfinite(at.lon)):
        return ""
    about = "" if e.note is None else element("description", html.escape(e.note))
    if picture is not None:
        about = picture_description(picture, caption=e.note or e.photo)
    look = when = style = ""
    if e.heading_deg is not None:
        heading = element("heading", f"{e.heading_deg % 360:g}")
        place = f"<longitude>{at.lon:.9f}</longitude><latitude>{at.lat:.9f}</latitude>"
        look = f"<LookAt>{place}{heading}<tilt>60</tilt><range>100</range></LookAt>"
        style = f"<Style><IconStyle>{heading}</IconStyle></Style>"
    if e.taken_at is not None and "T" in e.taken_at:
        when = f"<TimeStamp>{element('when', e.taken_at)}</TimeStamp>"
    name = element("name", e.photo.rsplit("/", 1)[-1])
    facts = {"id": e.id} | photo_properties(e) | floor_properties(map_, e.floor)
    return (
        f'<Placemark id="photo-{e.id}">{name}{about}{look}{when}{style}'
        f"{extended_data(facts)}{point(at)}</Placemark>\n"
    )


def _note(note: MapNote, map_: Map, georeference: Georeference) -> str:
    at = None if note.position is None else georeference.latlon_of(note.position)
    if at is None or not (math.isfinite(at.lat) and math.isfinite(at.lon)):
        return ""
    about = element("description", html.escape(note.text)) if note.text else ""
    floor = floor_properties(map_, note.floor)
    facts = extended_data(floor) if floor else ""
    name = element("name", note.title)
    return f'<Placemark id="note-{note.id}">{name}{about}{facts}{point(at)}</Placemark>\n'


def _ground(map_: Map, georeference: Georeference, *, href: str) -> str:
    """Write a ground overlay of the satellite image; its corners go counterclockwise from bottom left."""
    width, height = map_.satellite.width, map_.satellite.height
    corners = georeference.latlon_from_pixel([(0, height), (width, height), (width, 0), (0, 0)]).tolist()
    if not all(math.isfinite(value) for corner in corners for value in corner):
        return ""
    quad = " ".join(coordinates(LatLon(*corner)) for corner in corners)
    return (
        f"<GroundOverlay>{element('name', map_.satellite.path.rsplit('/', 1)[-1])}"
        f"<Icon>{element('href', href)}</Icon>"
        f"<gx:LatLonQuad>{element('coordinates', quad)}</gx:LatLonQuad></GroundOverlay>\n"
    )
