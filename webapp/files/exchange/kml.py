"""Writes a map as KML 2.3: a placemark a photo, with its direction, time and picture.

The standard library's XML writer escapes everything and has no state that two requests could share.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.model import Experience, Map

_KML = "http://www.opengis.net/kml/2.2"
_GX = "http://www.google.com/kml/ext/2.2"
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures that stand beside the KML in a KMZ.

    Attributes
    ----------
    photos : mapping of int to str
        Path in the KMZ of the picture of each photo, by id.
    ground : str or None
        Path in the KMZ of the satellite image.
    """

    photos: Mapping[int, str] = field(default_factory=dict)
    ground: str | None = None


def format_kml(
    map_: Map, georeference: Georeference, *, title: str, pictures: Pictures | None = None
) -> bytes:
    """Write the photos of a map as placemarks.

    Parameters
    ----------
    map_ : Map
    georeference : Georeference
    title : str
        Name of the map.
    pictures : Pictures, optional
        For a KMZ.

    Returns
    -------
    bytes
        UTF-8. A photo whose place has no position on the Earth is left out.
    """
    pictures = pictures or Pictures()
    root = ET.Element("kml", {"xmlns": _KML, "xmlns:gx": _GX})
    document = ET.SubElement(root, "Document")
    _text(document, "name", title)
    if pictures.ground is not None:
        _ground(document, map_, georeference, href=pictures.ground)
    for e in map_.experiences:
        _placemark(document, e, georeference, picture=pictures.photos.get(e.id))
    ET.indent(root, " ")
    xml: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return xml + b"\n"


def _placemark(parent: ET.Element, e: Experience, georeference: Georeference, *, picture: str | None) -> None:
    lat, lon = georeference.latlon_of(e.position)
    if not (math.isfinite(lat) and math.isfinite(lon)):
        return
    mark = ET.SubElement(parent, "Placemark", {"id": f"photo-{e.id}"})
    _text(mark, "name", e.photo.rsplit("/", 1)[-1])
    if picture is not None:
        # a description is HTML: escaped once for that, and once more as text of the XML
        _text(mark, "description", f'<p>{html.escape(e.photo)}</p><img src="{html.escape(picture)}" alt="">')
    if e.heading_deg is not None:
        look = ET.SubElement(mark, "LookAt")
        for name, value in (("longitude", lon), ("latitude", lat)):
            _text(look, name, f"{value:.9f}")
        for name, text in (("heading", f"{e.heading_deg % 360:g}"), ("tilt", "60"), ("range", "100")):
            _text(look, name, text)
    if e.taken_at is not None and "T" in e.taken_at:
        _text(ET.SubElement(mark, "TimeStamp"), "when", e.taken_at)
    if e.heading_deg is not None:
        icon = ET.SubElement(ET.SubElement(mark, "Style"), "IconStyle")
        _text(icon, "heading", f"{e.heading_deg % 360:g}")
    _facts(mark, e)
    _text(ET.SubElement(mark, "Point"), "coordinates", f"{lon:.9f},{lat:.9f}")


def _facts(mark: ET.Element, e: Experience) -> None:
    known = {
        "id": e.id,
        "photo": e.photo,
        "x_px": e.position.x,
        "y_px": e.position.y,
        "heading_deg": e.heading_deg,
        "fov_deg": e.fov_deg,
        "gps_accuracy_m": e.gps_accuracy_m,
        "taken_at": e.taken_at,
    }
    data = ET.SubElement(mark, "ExtendedData")
    for name, value in known.items():
        if value is not None:
            _text(ET.SubElement(data, "Data", {"name": name}), "value", str(value))


def _ground(parent: ET.Element, map_: Map, georeference: Georeference, *, href: str) -> None:
    """Lay the satellite image on the ground by its four corners, from bottom left against the clock."""
    width, height = map_.satellite.width, map_.satellite.height
    corners = georeference.latlon_from_pixel([(0, height), (width, height), (width, 0), (0, 0)]).tolist()
    if not all(math.isfinite(value) for corner in corners for value in corner):
        return
    ground = ET.SubElement(parent, "GroundOverlay")
    _text(ground, "name", map_.satellite.path.rsplit("/", 1)[-1])
    _text(ET.SubElement(ground, "Icon"), "href", href)
    quad = ET.SubElement(ground, "gx:LatLonQuad")
    _text(quad, "coordinates", " ".join(f"{lon:.9f},{lat:.9f}" for lat, lon in corners))


def _text(parent: ET.Element, tag: str, text: str) -> None:
    """Add an element with text; characters that XML cannot hold become question marks."""
    ET.SubElement(parent, tag).text = _NOT_XML.sub("?", text)
