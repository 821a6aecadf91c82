"""A map as one HTML page that opens without a network: Leaflet, image and small photos are inside."""

from __future__ import annotations

import base64
import html
import math
import re
from pathlib import Path
from typing import Any

import folium
from branca.element import Figure, MacroElement
from folium.raster_layers import ImageOverlay
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from webapp.core.mapmodel.model import Experience
from webapp.errors import UsageError
from webapp.progress import Progress
from webapp.render.mercator import MercatorPicture, to_mercator
from webapp.resources import resource_folder
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Download, Source
from webapp.tasks.maps.thumbnails import encoded, satellite_picture, thumbnail

MAX_PHOTOS = 5000
"""More would make a page that browsers cannot open."""

_SIDES = ((300, 480), (1500, 256), (MAX_PHOTOS, 128))
"""Up to so many photos, pictures of so many pixels: the page stays below some 50 MB."""

_IMAGE_SIDE = 4096
_CSS_URL = re.compile(r"url\((images/[a-z0-9-]+\.png)\)")


def run(source: Source, *, settings: Settings, progress: Progress | None = None) -> Download:
    """Give a map as a page: on the Earth where it has a georeference, else in pixels.

    Parameters
    ----------
    source : Source
    settings : Settings
    progress : Progress, optional
        One step a photo.

    Returns
    -------
    Download

    Raises
    ------
    UsageError
        The map has too many photos for one page.
    Cancelled
    """
    if len(source.map.experiences) > MAX_PHOTOS:
        raise UsageError(
            f"a page can hold {MAX_PHOTOS} photos, and the map has {len(source.map.experiences)}",
            hint="export a zip or KMZ instead",
        )
    page = _page(source, settings=settings, progress=progress or Progress())
    return Download(
        f"{source.name}.html", "text/html; charset=utf-8", iter([page.encode("utf-8", "replace")])
    )


class PhotoMarkers(MacroElement):
    """The markers of the photos; texts reach the page as data and never as HTML.

    Parameters
    ----------
    photos : list of dict
        `at` (latitude and longitude, or -y and x), `name`, `facts`, `heading`, `picture`.
    """

    def __init__(self, photos: list[dict[str, Any]]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._name = "PhotoMarkers"
        self.photos = photos
        self._template = exported_templates().get_template("exchange/photo_markers.html")


def _page(source: Source, *, settings: Settings, progress: Progress) -> str:
    satellite = source.map.satellite
    picture = satellite_picture(source.cfg, satellite.path, side=_IMAGE_SIDE, settings=settings)
    on_earth: MercatorPicture | None = None
    if picture is not None and source.map.georeference is not None:
        size = (satellite.width, satellite.height)
        on_earth = to_mercator(picture, source.map.georeference, size=size)
    page = empty_page("EPSG3857" if on_earth else "Simple", title=source.title)
    bounds: list[list[float]] = [[-float(satellite.height), 0.0], [0.0, float(satellite.width)]]
    if on_earth is not None:
        bounds = [[on_earth.south, on_earth.west], [on_earth.north, on_earth.east]]
        picture = on_earth.pixels
    if picture is not None:
        url = data_uri("image/webp", encoded(picture, ".webp"))
        ImageOverlay(url, bounds, pixelated=False).add_to(page)
    page.fit_bounds(bounds)
    photos = _photos(source, settings, progress, on_earth=on_earth is not None)
    page.add_child(PhotoMarkers(photos))
    return str(page.get_root().render())


def empty_page(crs: str, *, title: str) -> folium.Map:
    """Make a page with a Leaflet map; folium's own links to servers are left out.

    Parameters
    ----------
    crs : str
        `EPSG3857` or `Simple`, as folium names them.
    title : str
        Any text.
    """
    page = folium.Map(tiles=None, crs=crs)
    page.default_js = [("leaflet", data_uri("text/javascript", _leaflet("leaflet.js")))]
    page.default_css = [("leaflet_css", data_uri("text/css", _inlined_css()))]
    page.options.update(min_zoom=-8, max_zoom=24, zoom_snap=0.25)
    figure = page.get_root()
    assert isinstance(figure, Figure), "folium puts each map into one"
    figure.title = html.escape(title)
    return page


def _photos(
    source: Source, settings: Settings, progress: Progress, *, on_earth: bool
) -> list[dict[str, Any]]:
    experiences = source.map.experiences
    side = next(side for most, side in _SIDES if len(experiences) <= most)
    progress.size(len(experiences))
    found = []
    for e in experiences:
        progress.check()
        at = _at(source, e, on_earth=on_earth)
        jpeg = thumbnail(source, e, side=side, limits=settings.photo)
        if at is not None:
            found.append(
                {
                    "at": at,
                    "name": e.photo.rsplit("/", 1)[-1],
                    "facts": _facts(e, at if on_earth else None),
                    "heading": None if e.heading_deg is None else round(e.heading_deg, 1),
                    "picture": None if jpeg is None else data_uri("image/jpeg", jpeg),
                }
            )
        progress.advance()
    return found


def _at(source: Source, e: Experience, *, on_earth: bool) -> tuple[float, float] | None:
    """Where Leaflet has a photo: latitude and longitude, or -y and x; None where there is no such place."""
    if not on_earth:
        return -e.position.y, e.position.x
    lat, lon = source.georeference().latlon_of(e.position)
    return (lat, lon) if math.isfinite(lat) and math.isfinite(lon) else None


def _facts(e: Experience, latlon: tuple[float, float] | None) -> str:
    facts = [f"{e.id}", f"x {e.position.x:.1f}, y {e.position.y:.1f} px"]
    if latlon is not None:
        facts.append(f"{latlon[0]:.6f}, {latlon[1]:.6f}")
    if e.heading_deg is not None:
        facts.append(f"{e.heading_deg:.0f}°")
    if e.taken_at is not None:
        facts.append(e.taken_at)
    return " · ".join(facts)


def exported_templates() -> Environment:
    """Give the templates of folium's elements; they put data into scripts by `tojson` alone."""
    return Environment(
        loader=FileSystemLoader(resource_folder("templates")), autoescape=False, undefined=StrictUndefined
    )


def _leaflet(name: str) -> bytes:
    path: Path = resource_folder("static") / "vendor" / "leaflet" / name
    return path.read_bytes()


def _inlined_css() -> bytes:
    """Give Leaflet's CSS with its pictures inside."""
    return _CSS_URL.sub(
        lambda found: f"url({data_uri('image/png', _leaflet(found[1]))})", _leaflet("leaflet.css").decode()
    ).encode()


def data_uri(media_type: str, data: bytes) -> str:
    """Put a file into an address."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"
