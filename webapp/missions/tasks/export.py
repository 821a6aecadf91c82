"""What every export of a mission starts from, and the exports that are one file of text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from webapp.core.trajectory.outgoing import MissionOut
from webapp.errors import NotFound, PhotoError, UsageError
from webapp.missions.files.csv_writer import format_objects_csv, format_poses_csv
from webapp.missions.files.geojson_writer import format_mission_geojson
from webapp.missions.files.gpx_writer import format_mission_gpx
from webapp.missions.store import missions, reading
from webapp.missions.tasks import add_photo, export_kml
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download, plain_name

Writer = Callable[[MissionOut], Iterator[bytes]]

_WRITERS: dict[str, tuple[str, Writer]] = {
    "gpx": ("application/gpx+xml", format_mission_gpx),
    "geojson": ("application/geo+json", format_mission_geojson),
    "csv": ("text/csv; charset=utf-8", format_poses_csv),
    "objects.csv": ("text/csv; charset=utf-8", format_objects_csv),
}

FORMATS = ("kml", "kmz", *_WRITERS)


def export_mission(
    library: Library,
    mission_id: int,
    *,
    form: str,
    most: int | None = None,
    pictures: Settings | None = None,
) -> Download:
    """Export a mission, in a few megabytes of memory whatever its size.

    Parameters
    ----------
    form : str
        One of `FORMATS`: `csv` has the poses, `objects.csv` the objects.
    most : int, optional
        At most so many poses of each track, evenly spread.
    pictures : Settings, optional
        With it, a KMZ has previews of the photos of objects; they have no EXIF.

    Returns
    -------
    Download
        What is in the mission now. Its pieces raise `Conflict` where a track is written anew meanwhile.

    Raises
    ------
    UsageError
        There is no such format.
    NotFound
        There is no such mission.
    """
    if form not in FORMATS:
        raise UsageError(f"there is no format {form!r}", where="format", hint=f"use {', '.join(FORMATS)}")
    mission = reading.read(library.database, mission_id, most=most)
    if form == "kml":
        return export_kml.export_mission_kml(mission)
    if form == "kmz":
        find = None if pictures is None else partial(_picture, library, mission_id, settings=pictures)
        return export_kml.run_kmz(mission, picture=find)
    media_type, write = _WRITERS[form]
    joint = "-" if form == "objects.csv" else "."
    return Download(f"{plain_name(mission.name)}{joint}{form}", media_type, write(mission))


def _picture(library: Library, mission_id: int, sha256: str, *, settings: Settings) -> Path | None:
    """Find the preview of a photo; None where the photo never came, or is damaged."""
    try:
        with library.database.read() as session:
            photo = missions.find_photo(session, mission_id, sha256)
        return add_photo.preview_of(library, photo, kind="preview", settings=settings)
    except (NotFound, PhotoError):
        return None
