"""A map as GeoJSON."""

from __future__ import annotations

from webapp.files.exchange.geojson import format_geojson
from webapp.tasks.exchange.export_source import Download, Source


def run(source: Source) -> Download:
    """Give the photos of a map as points on the Earth.

    Raises
    ------
    UsageError
        The map has no georeference.
    """
    data = format_geojson(source.map, source.georeference(), title=source.title)
    return Download(f"{source.name}.geojson", "application/geo+json", data)
