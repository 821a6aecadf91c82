"""The layers of a map and of a mission: what programs for geographic data are given of them."""

from __future__ import annotations

import math
import os.path
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.connect.gis import styles
from webapp.connect.gis.geopackage import (
    FeatureTable,
    Geometry,
    GeoPackage,
    TableField,
    lines,
    point,
    polygon,
)
from webapp.core.geo.affine import apply_affine
from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.model import FACTS, WRITTEN, Experience, Map
from webapp.errors import MapError
from webapp.files.exchange.geojson import floor_properties
from webapp.files.maps.folder import photo_path
from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses, covariance_radius_m
from webapp.missions.files.geojson_writer import cut_at_meridian
from webapp.progress import Progress
from webapp.tasks.exchange.export_source import Source

Row = tuple[Geometry | None, Sequence[Any]]

_FLOOR = (
    TableField("floor", "TEXT", "Name of the floor"),
    TableField("level", "REAL", "Level of the floor; 0 is at ground level"),
)
_HEADING = TableField("heading_deg", "REAL", "Viewing direction, degrees clockwise from north")
_RADIUS = TableField("radius_m", "REAL", "68 % radius of the position, metres")

PHOTOS = FeatureTable(
    "photos",
    "Photos of the map at the positions where they were taken",
    "POINT",
    (
        TableField("id", "INTEGER", "Number of the photo on the map"),
        TableField("photo", "TEXT", "Path of the photo, relative to this file"),
        TableField("name", "TEXT", "Name of the original file"),
        _HEADING,
        TableField("fov_deg", "REAL", "Horizontal field of view, degrees"),
        _RADIUS,
        TableField("taken_at", "TEXT", "When it was taken, local time, ISO 8601"),
        TableField("time", "DATETIME", "When it was taken, UTC, if the time zone is known"),
        *_FLOOR,
        TableField("x_px", "REAL", "Pixels from the left edge of the map's image"),
        TableField("y_px", "REAL", "Pixels from the top edge of the map's image"),
        TableField("credit", "TEXT", "Author and licence"),
        *(TableField(name, "TEXT", FACTS[name].label or name) for name in WRITTEN),
    ),
    styles.arrows("#0072b2", size_mm=4.0, picture="photo"),
)
NOTES = FeatureTable(
    "notes",
    "Notes on spots of the map",
    "POINT",
    (
        TableField("id", "INTEGER", "Number of the note on the map"),
        TableField("title", "TEXT", "Title"),
        TableField("note", "TEXT", "Text"),
        TableField("photos", "TEXT", "Numbers of the photos that it refers to, with commas"),
        *_FLOOR,
    ),
    styles.dots("#d55e00", label="title"),
)
FLOORS = FeatureTable(
    "floors",
    "Outlines of the images of the floors",
    "POLYGON",
    (
        TableField("id", "INTEGER", "Number of the floor on the map"),
        TableField("name", "TEXT", "Name"),
        TableField("level", "REAL", "0 is at ground level"),
        TableField("height_m", "REAL", "Height above a reference common to all floors, metres"),
    ),
    styles.outlines("#666666", label="name"),
)

_TRACK = (
    TableField("track", "INTEGER", "Number of the track"),
    TableField("source", "TEXT", "gps, odometry, visual, fused or manual"),
    TableField("name", "TEXT", "Name of the track"),
)
TRACKS = FeatureTable(
    "tracks",
    "Tracks as lines; the measure (M) is the time, in seconds since 1970",
    "MULTILINESTRING",
    (
        *_TRACK,
        TableField("poses", "INTEGER", "Number of poses"),
        TableField("distance_m", "REAL", "Distance along all poses, metres"),
        TableField("first_time", "DATETIME", "Time of the first pose, UTC"),
        TableField("last_time", "DATETIME", "Time of the last pose, UTC"),
        TableField("remark", "TEXT", "What has been removed to save space"),
        TableField("stroke", "TEXT", "Line colour, #rrggbb"),
        TableField("stroke_width", "REAL", "Line width, pixels"),
        TableField("hidden", "BOOLEAN", "Whether it is shown only on demand"),
    ),
    styles.lines("track", {}),
    has_z=True,
    has_m=True,
)
POSES = FeatureTable(
    "poses",
    "The poses of the tracks",
    "POINT",
    (
        *_TRACK,
        TableField("time", "DATETIME", "UTC"),
        _HEADING,
        TableField("height_m", "REAL", "Height in the height system of the source, metres"),
        _RADIUS,
        TableField("travelled_m", "REAL", "Distance along the track since its first pose, metres"),
    ),
    styles.arrows("#009e73", size_mm=2.0),
    has_z=True,
)
OBJECTS = FeatureTable(
    "objects",
    "Objects that were seen",
    "POINT",
    (
        TableField("id", "TEXT", "Id of the object"),
        TableField("class", "TEXT", "What it is"),
        TableField("state", "TEXT", "found, confirmed, cleared or dismissed"),
        TableField("confidence", "REAL", "Confidence of the detector, 0 to 1"),
        TableField("sightings", "INTEGER", "How many times it was seen"),
        TableField("first_time", "DATETIME", "When it was first seen, UTC"),
        TableField("last_time", "DATETIME", "When it was last seen, UTC"),
        TableField("height_m", "REAL", "Height, metres"),
        _RADIUS,
        TableField("size_x_m", "REAL", "Its length, metres"),
        TableField("size_y_m", "REAL", "Its width, metres"),
        TableField("size_z_m", "REAL", "Its own height, metres"),
        TableField("photo", "TEXT", "SHA-256 of the photo that shows it"),
    ),
    styles.dots("#d55e00", label="class"),
    has_z=True,
)
AREAS = FeatureTable(
    "areas",
    "Search areas",
    "POLYGON",
    (
        TableField("id", "INTEGER", "Number of the area"),
        TableField("name", "TEXT", "Name"),
        TableField("searched", "BOOLEAN", "Whether it is marked as searched"),
        TableField("searched_time", "DATETIME", "When it was marked as searched, UTC"),
        TableField("created_time", "DATETIME", "When it was drawn, UTC"),
    ),
    styles.outlines("#cc79a7", label="name"),
)


def add_map(
    package: GeoPackage,
    source: Source,
    *,
    folder: Path,
    picture: Callable[[Experience], bytes | None],
    progress: Progress,
) -> int:
    """Write a map, and return the number of photos.

    Args:
        folder: Where the file will be, to which the paths of photos are relative.
        picture: Makes the JPEG to attach to a photo, if any.
        progress: One step per photo.

    Raises:
        UsageError: The map has no georeference.
    """
    map_, title = source.map, source.title
    georeference = source.georeference()
    progress.size(len(map_.experiences))
    count = package.add(
        PHOTOS,
        (_photo(e, source, folder=folder) for e in map_.experiences),
        title=f"{title}: photos",
    )
    for number, e in enumerate(map_.experiences, start=1):
        progress.check()
        jpeg = picture(e)
        if jpeg is not None:
            package.attach(PHOTOS, number, jpeg=jpeg)
        progress.advance()
    if map_.notes:
        package.add(NOTES, _notes(map_, georeference), title=f"{title}: notes")
    if map_.floors:
        package.add(FLOORS, (_floor(f, map_, georeference) for f in map_.floors), title=f"{title}: floors")
    return count


def add_mission(package: GeoPackage, mission: MissionExport, *, progress: Progress) -> tuple[int, int, int]:
    """Write a mission; return the numbers of tracks, poses and objects.

    Args:
        progress: One step per track.
    """
    progress.size(2 * len(mission.tracks))
    looks = {t.id: styles.LineLook(t.title, t.colour, t.width_px, not t.look.hidden) for t in mission.tracks}
    layer = replace(TRACKS, style=styles.lines("track", looks))
    areas = [drawing for drawing in mission.drawings if drawing.kind == "area"]
    if areas:
        package.add(AREAS, map(_area, areas), title=f"{mission.name}: areas")
    return (
        package.add(layer, _counted(map(_track, mission.tracks), progress), title=f"{mission.name}: tracks"),
        package.add(POSES, _poses(mission.tracks, progress), title=f"{mission.name}: poses"),
        package.add(OBJECTS, map(_object, mission.objects()), title=f"{mission.name}: objects"),
    )


def _counted(rows: Iterable[Row], progress: Progress) -> Iterator[Row]:
    for row in rows:
        progress.check()
        yield row
        progress.advance()


def place_of(position: MapPixel | None, georeference: Georeference) -> LatLon | None:
    """Convert a position on the map; None if it has no latitude and longitude."""
    found = None if position is None else georeference.latlon_of(position)
    return found if found is not None and math.isfinite(found.lat) and math.isfinite(found.lon) else None


def radius_of(e: Experience, georeference: Georeference) -> float | None:
    """Return the 68 % radius of a photo's position, metres; None if it is unknown."""
    if e.by_gps:
        return e.gps_accuracy_m
    if e.radius_px is None:
        return None
    metres = e.radius_px * georeference.metres_per_pixel(e.position)
    return metres if math.isfinite(metres) else None


def _point(at: LatLon | None) -> Geometry | None:
    return None if at is None else point(at)


def _relative(source: Source, photo: str, folder: Path) -> str:
    """Return the path of a photo from a folder, with forward slashes; that in the map if it is missing."""
    try:
        path = photo_path(source.cfg, photo).resolve()
        return Path(os.path.relpath(path, folder.resolve())).as_posix()
    except (MapError, ValueError):  # on another drive of Windows there is no relative path
        return photo


def _photo(e: Experience, source: Source, *, folder: Path) -> Row:
    georeference = source.georeference()
    on = floor_properties(source.map, e.floor)
    values = {
        "id": e.id,
        "photo": _relative(source, e.photo, folder),
        "name": e.name or e.photo.rpartition("/")[2],
        "radius_m": radius_of(e, georeference),
        "time": _moment(e.taken_at),
        "x_px": e.position.x,
        "y_px": e.position.y,
        "credit": None if e.source is None else e.source.credit,
        "floor": on.get("floor"),
        "level": on.get("level"),
    }
    row = [values[f.name] if f.name in values else getattr(e, f.name) for f in PHOTOS.fields]
    return _point(place_of(e.position, georeference)), row


def _moment(taken_at: str | None) -> str | None:
    """Return a time as GeoPackage has it; None if its time zone is unknown."""
    taken = None if taken_at is None else datetime.fromisoformat(taken_at)
    return None if taken is None or taken.tzinfo is None else moments([taken.timestamp()])[0]


def _notes(map_: Map, georeference: Georeference) -> Iterator[Row]:
    for note in map_.notes:
        on = floor_properties(map_, note.floor)
        photos = ",".join(map(str, note.photos)) or None
        values = (note.id, note.title, note.text or None, photos, on.get("floor"), on.get("level"))
        yield _point(place_of(note.position, georeference)), values


def _floor(floor: Floor, map_: Map, georeference: Georeference) -> Row:
    shown = floor.image or map_.satellite
    right, bottom = shown.width, shown.height
    corners = [MapPixel(x, y) for x, y in ((0, 0), (0, bottom), (right, bottom), (right, 0))]
    if floor.image is not None:
        corners = [apply_affine(floor.image.map_from_image, corner) for corner in corners]
    ring = georeference.latlon_from_pixel(corners)
    outline = polygon(ring) if np.isfinite(ring).all() else None
    return outline, (floor.id, floor.name, floor.level, floor.height_m)


def _area(area: ExportDrawing) -> Row:
    searched = None if area.searched_time_s is None else moments([area.searched_time_s])[0]
    (created,) = moments([area.created_time_s])
    return polygon(area.points), (area.id, area.name, area.searched, searched, created)


def _track(track: ExportTrack) -> Row:
    parts: list[NDArray[np.float64]] = []
    has_z, ends = True, [math.nan, math.nan]
    if track.count > 1:
        parts, has_z, ends = _lines(track)
    elif track.count == 1:
        (only,) = (part for part in track.poses() if len(part))
        ends = only.times_s[[0, -1]].tolist()
    width = [0, 1, *([2] if has_z else []), *([3] if track.timed else [])]
    chosen = [np.ascontiguousarray(part[:, width]) for part in parts if len(part) > 1]
    geometry = lines(chosen, has_z=has_z, has_m=track.timed) if chosen else None
    first, last = moments(ends) if track.timed else (None, None)
    facts = (track.count, track.distance_m, first, last, track.remark or None)
    look = (track.colour, track.width_px, track.look.hidden)
    return geometry, (track.id, track.source, track.label, *facts, *look)


def _lines(track: ExportTrack) -> tuple[list[NDArray[np.float64]], bool, list[float]]:
    """Return the lines of a track, (n, 4) with longitude, latitude, height and time; whether all heights are
    known; and the first and the last time."""
    done: list[NDArray[np.float64]] = []
    going: list[NDArray[np.float64]] = []
    for part, ends in cut_at_meridian(track.poses()):
        going.append(np.column_stack([part.latlon[:, ::-1], part.height_m, part.times_s]))
        if ends:
            done.append(np.vstack(going))
            going = []
    done.append(np.vstack(going))
    has_z = all(np.isfinite(line[:, 2]).all() for line in done)
    return done, bool(has_z), [float(done[0][0, 3]), float(done[-1][-1, 3])]


def _poses(tracks: Iterable[ExportTrack], progress: Progress) -> Iterator[Row]:
    for track in tracks:
        for part in track.poses():
            progress.check()
            yield from _part(track, part)
        progress.advance()


def _part(track: ExportTrack, part: Poses) -> Iterator[Row]:
    about = (track.id, track.source, track.label)
    times = moments(part.times_s.tolist()) if track.timed else [None] * len(part)
    table = zip(
        times, part.latlon.tolist(), part.heading_deg.tolist(), part.height_m.tolist(),
        part.covariance_m2.tolist(), part.travelled_m.tolist(), strict=True,
    )  # fmt: skip
    for time, latlon, heading, height, covariance, travelled in table:
        values = (*about, time, heading, height, covariance_radius_m(covariance), travelled)
        yield point(LatLon(*latlon), height), values


def _object(found: ExportObject) -> Row:
    first, last = moments([found.first_time_s, found.last_time_s])
    values = (
        found.id, found.kind, found.state, found.confidence, found.sightings, first, last, found.height_m,
        covariance_radius_m(found.covariance_m2), *(found.size_m or (None, None, None)), found.photo,
    )  # fmt: skip
    return point(found.latlon, found.height_m), values


def moments(times_s: Sequence[float]) -> list[str]:
    """Write times as GeoPackage has them: ISO 8601, to the millisecond, in UTC."""
    milliseconds = np.round(np.asarray(times_s, np.float64) * 1e3).astype(np.int64)
    written = np.datetime_as_string(milliseconds.astype("datetime64[ms]")).tolist()
    return [f"{time}Z" for time in written]
