"""A map's satellite image as JSON."""

from __future__ import annotations

from typing import Any

from webapp.files.satellite.pyramid import max_zoom
from webapp.store.schema import MapRecord
from webapp.tasks.satellite import display
from webapp.tasks.satellite.files import source_of
from webapp.web.state import library


def satellite_json(record: MapRecord, *, base: str | None = None) -> dict[str, Any] | None:
    """Give address and size of a map's image; None without one.

    Parameters
    ----------
    base : str, optional
        Address below which the image is found, instead of the one for people of the map.

    Returns
    -------
    dict or None
        `url`, `width`, `height`, `tiles` (`url` with {z}, {x} and {y}, and `max_zoom`) or null, and
        `attribution`: who is to be named where the image is shown, or null. Another content has another
        address, so that browsers may keep what they have.
    """
    key = display.key_of(library(), record)
    width, height = record.satellite_width, record.satellite_height
    if key is None or not width or not height:
        return None
    base = base or f"/api/v1/maps/{record.slug}/satellite"
    tiles = None
    if display.has_tiles(library(), record):
        tiles = {
            "url": f"{base}/tiles/{{z}}/{{x}}/{{y}}?v={key}",
            "max_zoom": max_zoom(width=width, height=height),
        }
    source = source_of(library().map_folder(record.slug), record.satellite_path or "")
    return {
        "url": f"{base}?v={key}",
        "width": width,
        "height": height,
        "tiles": tiles,
        "attribution": source.get("attribution"),
    }
