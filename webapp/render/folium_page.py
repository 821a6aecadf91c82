"""A map as one self-contained HTML page, with Leaflet, the image and small photos inside."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from webapp.core.mapmodel.model import Experience
from webapp.errors import UsageError
from webapp.progress import Progress
from webapp.render.mercator import MercatorPicture, to_mercator
from webapp.resources import resource_folder
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Download, Source, encode_picture, satellite_picture, thumbnail
from webapp.tasks.maps.walk import walk_of_map

if TYPE_CHECKING:
    import folium  # imported by the functions: slow to import, and rarely needed

MAX_PHOTOS = 5000
"""With more, browsers could not open the page."""

_SIDES = ((300, 480), (1500, 256), (MAX_PHOTOS, 128))
"""Maximum number of photos, and the size of their pictures in pixels: the page stays below some 50 MB."""

_IMAGE_SIDE = 4096
_ICON, _ICON_CENTRE = (26, 26), (13, 13)
_CSS = """<style>
html .leaflet-container { background: #e8eaed; }
.photo-marker svg { display: block; width: 26px; height: 26px; overflow: visible; }
.photo-marker circle { fill: #0b6bcb; stroke: #fff; stroke-width: 2; }
.photo-marker path { fill: #0b6bcb; stroke: #fff; stroke-width: 1.5; }
html .leaflet-popup-content { max-width: 480px; font: 14px/1.4 system-ui, sans-serif; }
html .leaflet-popup-content { overflow-wrap: anywhere; }
html .leaflet-popup-content img { display: block; max-width: 100%; height: auto; border-radius: 4px; }
html .leaflet-popup-content p { margin: 2px 0; }
.way { display: flex; align-items: center; gap: 8px; padding: 4px; border-radius: 8px;
  background: #fff; color: #1b2321; font: 14px/1.4 system-ui, sans-serif;
  box-shadow: 0 1px 5px rgb(0 0 0 / 0.5); }
.way button { min-width: 44px; min-height: 44px; border: 1px solid #7c8781; border-radius: 6px;
  background: #fff; font: inherit; cursor: pointer; }
</style>"""
_WAY = """{% macro script(this, kwargs) %}
{
  const map = {{ this._parent.get_name() }}, photos = [];
  map.eachLayer((layer) => layer.feature && layer.getLatLng && photos.push(layer));
  let at = -1;
  const count = Object.assign(document.createElement("span"), { textContent: `${photos.length}` });
  const go = (by) => {
    const to = Math.min(Math.max(at + by, 0), photos.length - 1);
    // The popup belongs to the whole layer, which opens it where a marker is clicked.
    if (to !== at) photos[to].fire("click", { latlng: photos[to].getLatLng() }, true);
  };
  photos.forEach((photo, n) => photo.on("click", () => {
    at = n;
    count.textContent = `${n + 1} / ${photos.length}`;
  }));
  const button = (sign, label, by) => {
    const made = document.createElement("button");
    made.setAttribute("aria-label", label);
    return Object.assign(made, { type: "button", textContent: sign, onclick: () => go(by) });
  };
  const bar = L.control({ position: "bottomleft" });
  bar.onAdd = () => {
    const box = Object.assign(document.createElement("div"), { className: "way" });
    box.append(button("\u2190", "Previous photo", -1), count, button("\u2192", "Next photo", 1));
    L.DomEvent.disableClickPropagation(box);
    return box;
  };
  bar.addTo(map);
  map.keyboard.disable();
  document.addEventListener("keydown", ({ key }) => {
    if (key === "ArrowRight") go(1);
    if (key === "ArrowLeft") go(-1);
  });
}
{% endmacro %}"""
"""Script that opens photo after photo, in the order of their features."""

_CSS_URL = re.compile(r"url\((images/[a-z0-9-]+\.png)\)")


def export_map_page(source: Source, *, settings: Settings, progress: Progress | None = None) -> Download:
    """Return a map as a page: in Web Mercator if it has a georeference, else in pixels.

    Raises:
        UsageError: The map has too many photos for one page.
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


def _page(source: Source, *, settings: Settings, progress: Progress) -> str:
    import folium

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
        url = data_uri("image/webp", encode_picture(picture, ".webp"))
        folium.raster_layers.ImageOverlay(url, bounds, pixelated=False).add_to(page)
    page.fit_bounds(bounds)
    photos = _photos(source, settings, progress, on_earth=on_earth is not None)
    icon = folium.DivIcon(icon_size=_ICON, icon_anchor=_ICON_CENTRE, class_name="photo-marker")
    add_features(page, photos, marker=folium.Marker(icon=icon), popup="photo-popup", name="Photos")
    if len(photos) > 1:
        _add_way(page)
    return str(page.get_root().render())


def empty_page(crs: str, *, title: str) -> folium.Map:
    """Make a page with a Leaflet map; folium's own links to servers are left out.

    Args:
        crs: `EPSG3857` or `Simple`, as folium names them.
    """
    import folium

    page = folium.Map(tiles=None, crs=crs)
    page.default_js = [("leaflet", data_uri("text/javascript", _leaflet("leaflet.js")))]
    page.default_css = [("leaflet_css", data_uri("text/css", _inlined_css()))]
    page.options.update(min_zoom=-8, max_zoom=24, zoom_snap=0.25)
    figure = page.get_root()
    assert isinstance(figure, folium.Figure), "folium puts each map into one"
    figure.title = html.escape(title)
    figure.header.add_child(folium.Element(_CSS))
    return page


def _add_way(page: folium.Map) -> None:
    """Add buttons and keys that open the next and the previous photo."""
    import folium
    from jinja2 import Template

    way = folium.MacroElement()  # type: ignore[no-untyped-call]
    way._template = Template(_WAY)
    page.add_child(way)


@dataclass(frozen=True, slots=True)
class Feature:
    """A marker or line of an exported page."""

    geometry: tuple[str, list[Any]]  # GeoJSON's type and coordinates: longitude and latitude, or x and -y
    # `title`, `facts`: Any text: it is escaped here, as Leaflet shows HTML.
    title: str
    facts: str
    # Leaflet's options of the marker, of its icon or of the line; never with untrusted text.
    style: Mapping[str, object]
    picture: bytes | None = None  # JPEG

    def geojson(self, id_: int) -> dict[str, Any]:
        """Convert to GeoJSON; `id_` is unique in the layer."""
        title = html.escape(self.title)
        about = f"<p><strong>{title}</strong></p><p><span>{html.escape(self.facts)}</span></p>"
        if self.picture is not None:
            # its size lets Leaflet place the popup correctly before the picture is decoded
            width, height = Image.open(io.BytesIO(self.picture)).size
            source = data_uri("image/jpeg", self.picture)
            about += f'<img src="{source}" width="{width}" height="{height}" alt="{title}">'
        kind, coordinates = self.geometry
        return {
            "type": "Feature",
            "id": id_,
            "geometry": {"type": kind, "coordinates": coordinates},
            "properties": {"title": title, "about": about},
        }


def add_features(
    page: folium.Map,
    features: list[Feature],
    *,
    popup: str,
    name: str,
    marker: folium.Marker | None = None,
) -> None:
    """Add a layer of features, each with a popup and a tooltip.

    Args:
        popup: Class of the popups.
        name: Of the layer.
        marker: Of points; the style of each feature overrides its options, or those of its icon.
    """
    if not features:
        return
    import folium

    styles = [dict(one.style) for one in features]
    folium.GeoJson(
        {"type": "FeatureCollection", "features": [one.geojson(n) for n, one in enumerate(features)]},
        name=name,
        marker=marker,
        style_function=lambda one: styles[one["id"]],
        popup=folium.GeoJsonPopup(
            ["about"], labels=False, localize=False, class_name=popup, max_width=500, min_width=200
        ),
        tooltip=folium.GeoJsonTooltip(["title"], labels=False, sticky=False),
    ).add_to(page)


def _photos(source: Source, settings: Settings, progress: Progress, *, on_earth: bool) -> list[Feature]:
    walk = walk_of_map(source.map)
    by_id = {e.id: e for e in source.map.experiences}
    experiences = [by_id[id] for id in walk.by_time or walk.by_place]
    side = next(side for most, side in _SIDES if len(experiences) <= most)
    progress.size(len(experiences))
    found = []
    for e in experiences:
        progress.check()
        at = _at(source, e, on_earth=on_earth)
        if at is not None:
            jpeg = thumbnail(source, e, side=side, limits=settings.photo)
            name, facts = e.photo.rsplit("/", 1)[-1], _facts(e, at if on_earth else None)
            style = {"html": _symbol(e.heading_deg)}
            point = ("Point", [at[1], at[0]])
            found.append(Feature(point, name, facts, style, jpeg))
        progress.advance()
    return found


def _symbol(heading_deg: float | None) -> str:
    """Draw a dot, with an arrow if the heading of the photo is known."""
    arrow = ""
    if heading_deg is not None:
        arrow = f"<path d='M13 -5 L18 5 L8 5 Z' transform='rotate({heading_deg:.1f} 13 13)'/>"
    return f"<svg viewBox='0 0 26 26' aria-hidden='true'>{arrow}<circle cx='13' cy='13' r='7'/></svg>"


def _at(source: Source, e: Experience, *, on_earth: bool) -> tuple[float, float] | None:
    """Return a photo's position in Leaflet: latitude and longitude, or -y and x; None if it has none."""
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
    if e.source is not None:
        facts.append(e.source.credit)
    return " · ".join(facts)


def _leaflet(name: str) -> bytes:
    path: Path = resource_folder("static") / "vendor" / "leaflet" / name
    return path.read_bytes()


def _inlined_css() -> bytes:
    """Return Leaflet's CSS with its pictures inlined."""
    return _CSS_URL.sub(
        lambda found: f"url({data_uri('image/png', _leaflet(found[1]))})", _leaflet("leaflet.css").decode()
    ).encode()


def data_uri(media_type: str, data: bytes) -> str:
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"
