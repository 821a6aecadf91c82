"""The collections of features: photos and notes of each map, tracks and objects of each mission."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from flask import url_for
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, and_, or_, select
from sqlalchemy.orm import Session

from webapp.connect.gis.cql2 import Kind
from webapp.connect.gis.layers import place_of, radius_of
from webapp.connect.gis.ogc_query import Box, ItemQuery
from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference, latlon_grid
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.model import WRITTEN, Experience
from webapp.core.mapmodel.notes import MapNote
from webapp.errors import NotFound, UsageError
from webapp.files.exchange.geojson import photo_properties, point_feature
from webapp.files.exchange.times import unix_time, utc
from webapp.missions.files.geojson_writer import object_feature, track_feature
from webapp.missions.store import missions, reading, tracks
from webapp.missions.store.schema import MissionObject, Track
from webapp.missions.web.context import open_mission
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import experience_of, floors, georeference, notes, placed_by_gps
from webapp.web.context import account, library, open_map, reading_map

_NAME = re.compile(
    r"map-(?P<slug>.{1,200})-(?P<of_map>photos|notes)|mission-(?P<id>\d{1,10})-(?P<of_mission>tracks|objects)"
)

_MOST_POSES = 200_000
"""Poses of the tracks in one answer."""

_POSES = 5000
"""Largest number of poses of a track, evenly spread."""

_ABOUT = {
    "photos": "Photos at the positions where they were taken",
    "notes": "Notes on spots of the map",
    "tracks": f"Tracks as lines of at most {_POSES} poses",
    "objects": "Objects that were seen",
}


_OF_PHOTOS: dict[str, Kind] = {
    "id": "number",
    "name": "text",
    "photo": "text",
    **dict.fromkeys(("heading_deg", "fov_deg", "gps_accuracy_m", "radius_m", "x_px", "y_px"), "number"),
    "taken_at": "time",
    "credit": "text",
    "floor": "text",
    "level": "number",
    **dict.fromkeys(WRITTEN, "text"),
}
_OF_TRACKS: dict[str, Kind] = {
    "id": "text",
    "source": "text",
    "name": "text",
    "poses": "number",
    "distance_m": "number",
    "first_time": "time",
    "last_time": "time",
}
_OF_OBJECTS: dict[str, Kind] = {
    "id": "text",
    "class": "text",
    "state": "text",
    "state_by": "text",
    "photo": "text",
    "confidence": "number",
    "sightings": "number",
    **dict.fromkeys(("first_time", "last_time", "state_time"), "time"),
}
_QUERYABLES: dict[str, dict[str, Kind]] = {
    "photos": _OF_PHOTOS,
    "notes": dict.fromkeys(("id", "title", "note", "photos", "floor"), "text"),
    "tracks": _OF_TRACKS,
    "objects": _OF_OBJECTS,
}
"""Properties that a filter may name, by kind of collection."""

_NO_FACTS: dict[str, Any] = {"id": "", "properties": {}}
_FILTER_S = 10.0
"""Time limit of looking for features that a filter wants."""

_PART = 500
"""Features that are read at once while a filter is applied."""


class CollectionName(NamedTuple):
    """What an id of a collection names."""

    kind: str  # `photos`, `notes`, `tracks` or `objects`
    slug: str | None  # Of the map
    mission_id: int | None


@dataclass(frozen=True, slots=True)
class Collection:
    """A collection."""

    id: str
    title: str
    about: str
    box: Box | None = None
    span_s: tuple[float, float] | None = None  # Unix seconds


@dataclass(frozen=True, slots=True)
class Items:
    """Some features of a collection."""

    features: list[dict[str, Any]]
    matched: int | None  # Number of all that are wanted; None if they have not been counted
    after: str | None  # Id of the last one, if more follow


def parse_name(id: str) -> CollectionName:
    """Parse the id of a collection. Raises NotFound."""
    found = _NAME.fullmatch(id)
    if found is None or int(found["id"] or 0) > MAX_NUMBER:
        raise NotFound("collection not found", where=id[:80], hint="see the list of collections")
    if found["slug"] is not None:
        return CollectionName(found["of_map"], found["slug"], None)
    return CollectionName(found["of_mission"], None, int(found["id"]))


def check_right(id: str) -> None:
    """Check that the caller may see a collection. Raises NotSignedIn, NotFound."""
    name = parse_name(id)
    if name.slug is not None:
        open_map(name.slug)
    else:
        open_mission(name.mission_id or 0)


def list_collections() -> list[Collection]:
    """List the collections of the maps with a georeference, and of the missions, that the caller may see."""
    who = account()
    with library().database.read() as session:
        of_maps = [
            c for record in maps.list_maps(session, who) if record.georeference for c in _of_map(record)
        ]
        entries = missions.list_missions(session, who)
        return of_maps + [c for e in entries for c in _of_mission(e.mission.id, e.mission.name, e.tracks)]


def describe(id: str) -> Collection:
    """Describe a collection. Raises NotSignedIn, NotFound."""
    name = parse_name(id)
    if name.slug is not None:
        found = _of_map(open_map(name.slug))
    else:
        mission = open_mission(name.mission_id or 0)
        with library().database.read() as session:
            found = _of_mission(mission.id, mission.name, tracks.list_tracks(session, mission.id))
    return next(one for one in found if one.id == id)


def _of_map(record: MapRecord) -> list[Collection]:
    box = map_box(record)
    return [
        Collection(f"map-{record.slug}-{kind}", f"{record.name}: {kind}", _ABOUT[kind], box)
        for kind in ("photos", "notes")
    ]


def map_box(record: MapRecord) -> Box | None:
    """Return the area of the image of a map; None if it is unknown, or crosses the 180th meridian."""
    found = georeference(record)
    if found is None or not record.satellite_width or not record.satellite_height:
        return None
    return _outline(found, (record.satellite_width, record.satellite_height))


def _outline(found: Georeference, size: tuple[int, int]) -> Box | None:
    """Return the area of an image; None if a part of it has no position, or it crosses the 180th meridian."""
    corners = [corner for corner in latlon_grid(found, size, cells=1).latlon if corner is not None]
    if len(corners) < 4:
        return None
    (south, west), (north, east) = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
    return (west, south, east, north) if east - west <= 180.0 else None


def _of_mission(id: int, name: str, found: Iterable[Track]) -> list[Collection]:
    there = [track for track in found if track.poses]
    boxes = [box for track in there if (box := _box_of(track)) is not None]
    box = None
    if boxes:
        (west, south, _, _), (_, _, east, north) = (
            np.min(boxes, axis=0).tolist(),
            np.max(boxes, axis=0).tolist(),
        )
        box = (west, south, east, north)
    timed = [track for track in there if track.timed]
    times = [time for t in timed for time in (t.first_time_s, t.last_time_s) if time is not None]
    span_s = (min(times), max(times)) if times else None
    return [
        Collection(f"mission-{id}-{kind}", f"{name}: {kind}", _ABOUT[kind], box, span_s)
        if kind == "tracks"
        else Collection(f"mission-{id}-{kind}", f"{name}: {kind}", _ABOUT[kind])
        for kind in ("tracks", "objects")
    ]


def _box_of(track: Track) -> Box | None:
    west, south, east, north = track.min_lon, track.min_lat, track.max_lon, track.max_lat
    if west is None or south is None or east is None or north is None:
        return None
    return (west, south, east, north)


def queryables(id: str) -> dict[str, Kind]:
    """Return what a filter on a collection may name. Raises NotFound."""
    return _QUERYABLES[parse_name(id).kind]


def items(id: str, query: ItemQuery) -> Items:
    """Read some features of a collection. Raises NotSignedIn, NotFound."""
    name = parse_name(id)
    if name.slug is not None:
        with reading_map(name.slug) as (session, record):
            if name.kind == "photos":
                return _photos(session, record, query)
            return _page([note for note in _notes(record) if query.wants(note)], query)
    mission_id = open_mission(name.mission_id or 0).id
    return _tracks(mission_id, query) if name.kind == "tracks" else _objects(mission_id, query)


def item(id: str, feature_id: str) -> dict[str, Any]:
    """Read one feature. Raises NotSignedIn, NotFound."""
    name = parse_name(id)
    found: dict[str, Any] | None = None
    if name.slug is not None:
        with reading_map(name.slug) as (session, record):
            if name.kind == "notes":
                found = next((f for f in _notes(record) if f["id"] == feature_id), None)
            elif feature_id.isascii() and feature_id.isdecimal() and int(feature_id[:11]) <= MAX_NUMBER:
                found = next(_photo_features(session, record, [int(feature_id)]), None)
    else:
        mission_id = open_mission(name.mission_id or 0).id
        if name.kind == "tracks":
            listed = [track for track in _listed_tracks(mission_id) if f"track-{track.id}" == feature_id]
            found = next(_track_features(mission_id, listed), None)
        else:
            with library().database.read() as session:
                found = _object(missions.find_object(session, mission_id, feature_id))
    if found is None:
        raise NotFound("feature not found in the collection", where=feature_id[:80])
    return found


def wanted_photos(session: Session, record: MapRecord, query: ItemQuery) -> NDArray[np.int64]:
    """Return the ids of the placed photos of a map, sorted, that are wanted by area and time."""
    dots = maps.dots(session, record, placed=True)
    ids = np.array([dot.id for dot in dots], np.int64)
    latlon = np.full((len(dots), 2), np.nan)
    found = georeference(record)
    if found is not None and len(dots):
        latlon = found.latlon_from_pixel(np.array([(dot.x_px, dot.y_px) for dot in dots], np.float64))
    wanted = query.within(latlon[:, 0], latlon[:, 1])
    if query.span_s is not None:
        times = photo_times(session, record)
        taken_s = [times.get(id, math.nan) for id in ids.tolist()]
        wanted &= [query.during(time_s, time_s) for time_s in taken_s]
    return ids[wanted]


def photo_times(session: Session, record: MapRecord) -> dict[int, float]:
    """Return when the photos of a map that have a time were taken, Unix seconds; NaN if it is no time."""
    columns = select(Photo.id, Photo.taken_at)
    rows = session.execute(columns.where(Photo.map_id == record.id, Photo.taken_at.is_not(None)))
    return {id: unix_time(taken) for id, taken in rows if taken is not None}


def _photos(session: Session, record: MapRecord, query: ItemQuery) -> Items:
    matched = wanted_photos(session, record, query)
    after = int(query.after) if query.after and query.after.isdecimal() and len(query.after) < 12 else -1
    rest = matched[matched > after]
    if query.filter is not None:
        parts = (rest[n : n + _PART].tolist() for n in range(0, len(rest), _PART))
        return _filtered((f for part in parts for f in _photo_features(session, record, part)), query)
    page = rest[: query.limit].tolist()
    more = str(page[-1]) if len(rest) > query.limit else None
    return Items(list(_photo_features(session, record, page)), len(matched), more)


def _filtered(candidates: Iterable[dict[str, Any]], query: ItemQuery) -> Items:
    """Return the first features that a filter wants.

    Raises:
        UsageError: Looking for them takes too long.
    """
    found: list[dict[str, Any]] = []
    until = time.monotonic() + _FILTER_S
    for feature in candidates:
        if query.wants(feature):
            found.append(feature)
        if len(found) > query.limit:
            return Items(found[: query.limit], None, str(found[query.limit - 1]["id"]))
        if time.monotonic() > until:
            raise UsageError(
                f"the filter takes more than {_FILTER_S:g} seconds",
                where="filter",
                hint="add bbox or datetime, or ask for fewer features",
            )
    return Items(found, None, None)


def placed_photos(
    session: Session, record: MapRecord, ids: list[int]
) -> Iterator[tuple[Photo, Experience, Floor | None]]:
    """Yield those photos that are placed, with their floors, in the order of the ids."""
    photos = maps.photos_by_id(session, record, ids)
    by_gps = placed_by_gps(photos.values(), georeference(record))
    named = {floor.id: floor for floor in floors(record)}
    for id in ids:
        photo = photos.get(id)
        e = None if photo is None or photo.removed else experience_of(photo, by_gps=id in by_gps)
        if photo is not None and e is not None:
            yield photo, e, named.get(e.floor)


def _photo_features(session: Session, record: MapRecord, ids: list[int]) -> Iterator[dict[str, Any]]:
    found = georeference(record)
    for photo, e, floor in placed_photos(session, record, ids):
        properties = {**photo_properties(e), "name": e.name or e.photo.rpartition("/")[2]}
        properties["radius_m"] = None if found is None else radius_of(e, found)
        properties["picture"] = url_for("api_photos.preview", slug=record.slug, id=photo.id, _external=True)
        if floor is not None:
            properties |= {"floor": floor.name, "level": floor.level}
        at = None if found is None else place_of(e.position, found)
        yield json.loads(point_feature(photo.id, at, properties=properties))


def _notes(record: MapRecord) -> Iterator[dict[str, Any]]:
    found = georeference(record)
    named = {floor.id: floor for floor in floors(record)}
    for note in sorted(notes(record), key=lambda note: note.id):
        yield _note(note, found, {"floor": named[note.floor].name} if note.floor in named else {})


def _note(note: MapNote, found: Georeference | None, more: dict[str, Any]) -> dict[str, Any]:
    at = None if found is None else place_of(note.position, found)
    about = {"title": note.title, "note": note.text or None, "photos": ",".join(map(str, note.photos))}
    feature: dict[str, Any] = json.loads(point_feature(f"note-{note.id}", at, properties=about | more))
    return feature


def _page(features: list[dict[str, Any]], query: ItemQuery) -> Items:
    """Return the wanted points of a short list."""
    places = [(f["geometry"] or {"coordinates": (math.nan, math.nan)})["coordinates"][:2] for f in features]
    lon, lat = np.array(places, np.float64).reshape(-1, 2).T
    wanted = [f for f, is_inside in zip(features, query.within(lat, lon), strict=True) if is_inside]
    ids = [f["id"] for f in wanted]
    begin = ids.index(query.after) + 1 if query.after in ids else 0
    page = wanted[begin : begin + query.limit]
    more = page[-1]["id"] if begin + query.limit < len(wanted) else None
    return Items(page, len(wanted), more)


def _listed_tracks(mission_id: int) -> list[Track]:
    with library().database.read() as session:
        found = tracks.list_tracks(session, mission_id)
    return sorted((track for track in found if track.poses), key=lambda track: track.id)


def _tracks(mission_id: int, query: ItemQuery) -> Items:
    facts = {} if query.filter is None else _track_facts(mission_id)
    wanted = [
        track
        for track in _listed_tracks(mission_id)
        if query.touches(_box_of(track))
        and (not track.timed or query.during(track.first_time_s, track.last_time_s))
        and (query.filter is None or query.wants(facts.get(track.id, _NO_FACTS)))
    ]
    names = [f"track-{track.id}" for track in wanted]
    begin = names.index(query.after) + 1 if query.after in names else 0
    page = wanted[begin : begin + query.limit]
    more = names[begin + query.limit - 1] if begin + query.limit < len(wanted) else None
    return Items(list(_track_features(mission_id, page)), len(wanted), more)


def _track_facts(mission_id: int) -> dict[int, dict[str, Any]]:
    """Return the features of the tracks by their numbers, only with properties that a filter may name."""
    found = {track.id: track for track in _listed_tracks(mission_id)}
    facts = {}
    for track in reading.read(library().database, mission_id, most=_POSES).tracks:
        if track.id in found:
            about = {"source": track.source, "name": track.label, "poses": track.count}
            about |= {"distance_m": track.distance_m, **_times(found[track.id])}
            facts[track.id] = {"id": f"track-{track.id}", "properties": about}
    return facts


def _times(track: Track) -> dict[str, str]:
    if not track.timed or track.first_time_s is None or track.last_time_s is None:
        return {}
    first, last = utc([track.first_time_s, track.last_time_s])
    return {"first_time": first, "last_time": last}


def _track_features(mission_id: int, wanted: list[Track]) -> Iterator[dict[str, Any]]:
    most = max(2, min(_POSES, _MOST_POSES // max(len(wanted), 1)))
    mission = reading.read(library().database, mission_id, most=most)
    exported = {track.id: track for track in mission.tracks}
    for track in wanted:
        if track.id not in exported:  # it was deleted meanwhile
            continue
        feature = json.loads("".join(track_feature(exported[track.id])))
        feature["properties"] |= _times(track)
        yield feature


def _objects(mission_id: int, query: ItemQuery) -> Items:
    conditions = list(_conditions(query))
    if query.filter is not None:
        return _filtered(_all_objects(mission_id, conditions, after=query.after), query)
    with library().database.read() as session:
        rows, matched = reading.find_objects(
            session, mission_id, within=conditions, after=query.after, most=query.limit + 1
        )
    page = rows[: query.limit]
    more = page[-1].object_id if len(rows) > query.limit else None
    return Items([_object(row) for row in page], matched, more)


def _all_objects(
    mission_id: int, conditions: list[ColumnElement[bool]], *, after: str | None
) -> Iterator[dict[str, Any]]:
    while True:
        with library().database.read() as session:
            rows, _ = reading.find_objects(session, mission_id, within=conditions, after=after, most=_PART)
        yield from map(_object, rows)
        if len(rows) < _PART:
            return
        after = rows[-1].object_id


def _object(row: MissionObject) -> dict[str, Any]:
    feature: dict[str, Any] = json.loads(object_feature(reading.as_exported(row, people=True)))
    return feature


def _conditions(query: ItemQuery) -> Iterator[ColumnElement[bool]]:
    if query.box is not None:
        west, south, east, north = query.box
        yield MissionObject.lat.between(south, north)
        join = and_ if west <= east else or_
        yield join(MissionObject.lon >= west, MissionObject.lon <= east)
    if query.span_s is not None:
        first, last = query.span_s
        if first > -math.inf:
            yield MissionObject.last_time_s >= first
        if last < math.inf:
            yield MissionObject.first_time_s <= last
