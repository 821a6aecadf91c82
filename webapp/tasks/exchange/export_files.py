"""Downloads of a map (`.cfg`, GeoJSON, KML, KMZ, or all as a zip), and of its answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock

from webapp.core.mapmodel.model import Map
from webapp.errors import DiskFull, DiskReadOnly, MapError, NotFound
from webapp.files.exchange.answers import (
    AnswerRow,
    format_answers_csv,
    format_answers_geojson,
    format_answers_gpx,
)
from webapp.files.exchange.geojson import format_geojson
from webapp.files.exchange.kml import Pictures, format_kml
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.files.maps.cfg import format_cfg, read_bytes
from webapp.files.maps.folder import json_path, photo_path, placed_map, placement_path
from webapp.files.maps.map_json import format_map_json
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.exchange.export_source import (
    Download,
    Source,
    encode_picture,
    of_library,
    plain_name,
    satellite_picture,
    thumbnail,
)
from webapp.tasks.maps import export

UNPLACED = "unplaced"
"""Folder of the zip for the photos in the tray; below it they have their paths in the map's folder."""

MEDIA_TYPE = "text/plain; charset=utf-8"

PHOTO_SIDE = 640
GROUND_SIDE = 2048
"""Pixels of the longer side; a larger texture is scaled down by many devices anyway."""


def export_map_zip(library: Library, map_id: int, *, progress: Progress | None = None) -> Download:
    """Return a map of the library as a zip that is generated while it is streamed.

    Photos that are missing on the disk are left out: the linter reports them after an import.

    Raises:
        NotFound, UsageError: The map does not exist, or it has no satellite image yet.
    """
    source = of_library(library, map_id)
    texts = map_files(library, map_id, source=source)
    pieces = stream_zip(_members(source, texts, progress or Progress()))
    return Download(f"{source.name}.zip", "application/zip", pieces)


def _members(source: Source, texts: Mapping[str, bytes], progress: Progress) -> Iterator[ZipMember]:
    for name, text in texts.items():
        yield ZipMember(name, text)
    plans = (floor.image.path for floor in source.map.floors if floor.image)
    names = dict.fromkeys([source.map.satellite.path, *plans, *(e.photo for e in source.map.experiences)])
    members = [*((name, name) for name in names), *_unplaced(source, taken=set(names))]
    progress.size(len(members))
    for member, name in members:
        progress.check()
        path = _path(source.cfg, name)
        if path is not None:
            yield ZipMember(member, path)
        progress.advance()


def _unplaced(source: Source, *, taken: set[str]) -> Iterator[tuple[str, str]]:
    """Yield the paths of the photos in the tray: in the zip, and in the map's folder."""
    for name in dict.fromkeys(source.unplaced):
        member = f"{UNPLACED}/{name}"
        while member in taken:  # the map has a folder of that name
            member = f"{UNPLACED}/{member}"
        if name not in taken:
            yield member, name


def _path(cfg: Path, name: str) -> Path | None:
    """Find a file of the map; None if it is missing or a link leads out of the folder."""
    try:
        path = photo_path(cfg, name)
    except MapError:
        return None
    return path if path.is_file() else None


def export_map_cfg(library: Library, map_id: int, *, placement: str | None = None) -> Download:
    """Return a map file.

    Args:
        placement: Name of a further placement; None for the map itself.

    Raises:
        NotFound: The map or the placement does not exist.
        UsageError: The map has no satellite image yet.
    """
    source = of_library(library, map_id)
    name = "map.cfg" if placement is None else f"{placement}.cfg"
    texts = map_files(library, map_id, source=source)
    if name not in texts:
        raise NotFound(f"the map has no placement {placement!r}", hint="reload the page")
    own = source.name if placement is None else f"{source.name}-{placement}"
    return Download(f"{own}.cfg", MEDIA_TYPE, iter([texts[name]]))


def map_files(library: Library, map_id: int, *, source: Source) -> dict[str, bytes]:
    """Return the text files of a map, all of the same revision, by name.

    They are read from the disk; if the `.cfg` there was changed from outside, or cannot be brought up to
    date as the disk takes nothing, they are made from `source`.
    """
    try:
        is_current = export.export_map(library, map_id)
    except (DiskFull, DiskReadOnly):
        is_current = False
    if not is_current:
        return texts_of(source.map)
    with FileLock(source.cfg.parent / "derived" / export.LOCK):
        paths = [source.cfg, json_path(source.cfg)]
        paths += [placement_path(source.cfg, p.name) for p in source.map.placements]
        return {path.name: read_bytes(path) for path in paths if path.exists()}


def texts_of(map_: Map) -> dict[str, bytes]:
    texts: Mapping[str, bytes] = {
        "map.cfg": format_cfg(map_),
        "map.json": format_map_json(map_),
    }
    return {**texts, **{f"{p.name}.cfg": format_cfg(placed_map(map_, p)) for p in map_.placements}}


def export_map_kml(source: Source) -> Download:
    data = format_kml(source.map, source.georeference(), title=source.title)
    return Download(f"{source.name}.kml", "application/vnd.google-earth.kml+xml", data)


def export_map_kmz(source: Source, *, settings: Settings, progress: Progress | None = None) -> Download:
    """Return the photos of a map as KMZ, generated while it is streamed."""
    source.georeference()
    pieces = stream_zip(_kmz_members(source, settings=settings, progress=progress or Progress()))
    return Download(f"{source.name}.kmz", "application/vnd.google-earth.kmz", pieces)


def _kmz_members(source: Source, *, settings: Settings, progress: Progress) -> Iterator[ZipMember]:
    """Yield the pictures, then the KML, which refers only to those that could be made."""
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
        yield ZipMember(ground, encode_picture(image))
    kml = format_kml(source.map, source.georeference(), title=source.title, pictures=Pictures(there, ground))
    yield ZipMember("doc.kml", kml)


def export_map_geojson(source: Source) -> Download:
    """Return the photos of a map as points on the Earth."""
    data = format_geojson(source.map, source.georeference(), title=source.title)
    return Download(f"{source.name}.geojson", "application/geo+json", data)


AnswerFormat = Literal["csv", "gpx", "geojson"]


@dataclass(frozen=True, slots=True)
class AnswerRange:
    # `first`, `last`: Ids, inclusive; None for no limit.
    first: int | None = None
    last: int | None = None
    account_id: int | None = None  # Account that asked; None for all


def export_answers(library: Library, map_id: int, *, form: AnswerFormat, which: AnswerRange) -> Download:
    """Write answers of a map, the oldest first."""
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        found = queries.answers(
            session, record, first=which.first, last=which.last, account_id=which.account_id
        )
        rows, title, name = [_row(query) for query in found], record.name, plain_name(record.slug)
    match form:
        case "csv":
            return Download(f"{name}-answers.csv", "text/csv; charset=utf-8", format_answers_csv(rows))
        case "gpx":
            data = format_answers_gpx(rows, title=title)
            return Download(f"{name}-answers.gpx", "application/gpx+xml", data)
        case _:
            data = format_answers_geojson(rows, title=title)
            return Download(f"{name}-answers.geojson", "application/geo+json", data)


def _row(query: QueryRecord) -> AnswerRow:
    first: dict[str, Any] = next(iter(query.answer["hypotheses"]), {})
    return AnswerRow(
        id=query.id,
        photo=query.name,
        probability=first.get("probability"),
        off_map_probability=query.answer.get("off_map_probability"),
        x_px=first.get("x_px"),
        y_px=first.get("y_px"),
        lat=first.get("lat"),
        lon=first.get("lon"),
        radius_m=first.get("radius_m"),
        heading_deg=first.get("heading_deg"),
        floor=first.get("floor_name"),
    )
