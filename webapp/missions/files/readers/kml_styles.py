"""Line styles of a KML: shared ones by their ids, and those in placemarks."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

from webapp.files.exchange.xml import child_text, local_name

STYLES = {"Style", "StyleMap", "CascadingStyle"}
_KML_ID = "{http://www.opengis.net/kml/2.2}id"

_MOST = 2000
"""Maximum number of shared styles that are remembered."""


@dataclass(slots=True)
class LineStyles:
    """The shared styles so far; programs write them before the placemarks that use them."""

    # Colour and width as the file has them, by the ids of styles; and ids of styles by those of style maps.
    _known: dict[str, tuple[str, str]] = field(default_factory=dict)
    _maps: dict[str, str] = field(default_factory=dict)

    def add(self, element: Element) -> None:
        """Remember a shared style or style map."""
        id_ = element.get("id") or element.get(_KML_ID)
        if not id_ or len(self._known) + len(self._maps) >= _MOST:
            return
        if local_name(element) == "Style":
            self._known[id_] = _line_style(element)
            return
        for part in element:
            if local_name(part) == "Style":  # in a gx:CascadingStyle, as Google Earth on the web writes them
                self._known[id_] = _line_style(part)
            elif child_text(part, "key") == "normal":
                self._maps[id_] = _id(child_text(part, "styleUrl"))

    def of(self, placemark: Element) -> tuple[str, str]:
        """Return the colour, `#rrggbb`, and the width of the lines of a placemark; empty if unknown."""
        id_ = _id(child_text(placemark, "styleUrl"))
        colour, width = self._known.get(self._maps.get(id_, id_), ("", ""))
        for element in placemark:
            if local_name(element) == "Style":  # overrides the shared one
                own_colour, own_width = _line_style(element)
                colour, width = own_colour or colour, own_width or width
        return colour, width


def _id(url: str) -> str:
    return url.strip().removeprefix("#")


def _line_style(style: Element) -> tuple[str, str]:
    for element in style:
        if local_name(element) == "LineStyle":
            return _colour(child_text(element, "color").strip()), child_text(element, "width").strip()
    return "", ""


def _colour(text: str) -> str:
    """Convert KML's order (opacity, blue, green, red) to `#rrggbb`; empty for other texts."""
    return f"#{text[6:8]}{text[4:6]}{text[2:4]}" if len(text) == 8 else ""
