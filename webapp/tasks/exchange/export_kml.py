"""A map as KML, and as KMZ with small pictures of its photos and the satellite image on the ground."""

from __future__ import annotations

from collections.abc import Iterator

from webapp.files.exchange.kml import Pictures, format_kml
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Download, Source
from webapp.tasks.maps.thumbnails import encoded, satellite_picture, thumbnail

PHOTO_SIDE = 640
GROUND_SIDE = 2048
"""Pixels of the longer side; a larger texture is scaled down by many devices anyway."""


def run(source: Source) -> Download:
    """Give the photos of a map as KML.

    Raises
    ------
    UsageError
        The map has no georeference.
    """
    data = format_kml(source.map, source.georeference(), title=source.title)
    return Download(f"{source.name}.kml", "application/vnd.google-earth.kml+xml", data)


def run_kmz(source: Source, *, settings: Settings, progress: Progress | None = None) -> Download:
    """Give the photos of a map as KMZ, made while it is taken.

    Parameters
    ----------
    progress : Progress, optional
        One step a photo.

    Raises
    ------
    UsageError
        The map has no georeference.
    """
    source.georeference()
    pieces = stream_zip(_members(source, settings=settings, progress=progress or Progress()))
    return Download(f"{source.name}.kmz", "application/vnd.google-earth.kmz", pieces)


def _members(source: Source, *, settings: Settings, progress: Progress) -> Iterator[ZipMember]:
    """Give the pictures, then the KML: it names those that could be made."""
    there: dict[int, str] = {}
    progress.size(len(source.map.experiences))
    for e in source.map.experiences:
        progress.check()
        jpeg = thumbnail(source, e, side=PHOTO_SIDE, limits=settings.photo)
        if jpeg is not None:
            there[e.id] = f"files/{e.id}.jpg"
            yield ZipMember(there[e.id], jpeg)
        progress.advance()
    image = satellite_picture(source.cfg, source.map.satellite.path, side=GROUND_SIDE, settings=settings)
    ground = None if image is None else "files/satellite.jpg"
    if image is not None and ground is not None:
        yield ZipMember(ground, encoded(image))
    kml = format_kml(source.map, source.georeference(), title=source.title, pictures=Pictures(there, ground))
    yield ZipMember("doc.kml", kml)
