"""Photos of maps as STAC items: a collection per map, an item per placed photo."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from flask import request, url_for
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from webapp.connect.gis.layers import place_of, radius_of
from webapp.connect.gis.ogc_collections import map_box, photo_times, placed_photos, wanted_photos
from webapp.connect.gis.ogc_query import ItemQuery
from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.model import Experience
from webapp.errors import NotFound
from webapp.files.decode import IMAGE_FORMATS
from webapp.files.exchange.times import unix_time, utc
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.web.context import account, library, open_map, reading_map

VERSION = "1.1.0"
_EXTENSIONS = [
    f"https://stac-extensions.github.io/{name}/schema.json"
    for name in ("perspective-imagery/v1.0.0", "view/v1.0.0")
]
_WORLD = (-180.0, -90.0, 180.0, 90.0)
_OLDEST = "1826-01-01T00:00:00Z"
"""No photo is older: what is known of one without a time is when it came into the map."""

_SPDX = re.compile(r"[A-Za-z0-9.-]+")
_MEDIA_TYPES = {suffix: form.media_types[0] for form in IMAGE_FORMATS.values() for suffix in form.suffixes}


@dataclass(frozen=True, slots=True)
class Found:
    """Some items."""

    items: list[dict[str, Any]]
    matched: int | None  # Number of all that are wanted; None if they have not been counted
    after: str | None  # Id of the last one, if more follow
    # Id after which the page before this one begins; empty: it is the first; None: this is the first.
    before: str | None = None


@dataclass(frozen=True, slots=True)
class Scope:
    """Where a search looks; None: everywhere."""

    collections: frozenset[str] | None = None
    ids: frozenset[str] | None = None

    def numbers(self, slug: str) -> set[int] | None:
        """Return the numbers of the photos of a map that are in it; None: all."""
        if self.collections is not None and slug not in self.collections:
            return set()
        if self.ids is None:
            return None
        named = [_split(id) for id in self.ids]
        return {number for of, number in named if of == slug}


def visible() -> list[MapRecord]:
    """List the maps with a georeference that the caller may see, by their names in addresses."""
    with library().database.read() as session:
        found = maps.list_maps(session, account())
    return sorted((record for record in found if record.georeference), key=lambda record: record.slug)


def check_right(slug: str) -> None:
    """Check that the caller may see a collection. Raises NotSignedIn, NotFound."""
    if open_map(slug).georeference is None:
        raise NotFound("the map has no georeference", where=slug, hint="georeference it in the editor first")


def search(query: ItemQuery, scope: Scope) -> Found:
    """Read some items of all maps that the caller may see, by map and number."""
    from_slug, after = _split(query.after) if query.after else ("", -1)
    wanted = [record for record in visible() if record.slug >= from_slug]
    found: list[dict[str, Any]] = []
    with library().database.read() as session:
        for record in wanted:
            ids = _numbers(session, record, query, scope=scope)
            rest = ids[ids > after] if record.slug == from_slug else ids
            room = query.limit - len(found)
            found += _items(session, record, rest[:room].tolist())
            if len(rest) > room:
                following = found[-1]["id"] if found else query.after
                return Found(found, None, following, _before(session, query, scope=scope))
        return Found(found, None if query.after else len(found), None, _before(session, query, scope=scope))


def of_map(slug: str, query: ItemQuery, *, scope: Scope) -> Found:
    """Read some items of a collection. Raises NotSignedIn, NotFound."""
    with reading_map(slug) as (session, record):
        ids = _numbers(session, record, query, scope=scope)
        rest = ids[ids > (_split(query.after)[1] if query.after else -1)]
        page = rest[: query.limit].tolist()
        more = f"{slug}-{page[-1]}" if len(rest) > query.limit else None
        earlier = [(slug, ids[: len(ids) - len(rest)])]
        return Found(list(_items(session, record, page)), len(ids), more, _last_page(earlier, query.limit))


def item(slug: str, id: str) -> dict[str, Any]:
    """Read an item. Raises NotSignedIn, NotFound."""
    of, number = _split(id)
    if of == slug:
        with reading_map(slug) as (session, record):
            for found in _items(session, record, [number]):
                return found
    raise NotFound("photo not found in the collection", where=id[:80])


def collection(record: MapRecord) -> dict[str, Any]:
    """Describe a map, without links."""
    with library().database.read() as session:
        times = [time for time in photo_times(session, record).values() if math.isfinite(time)]
    span = utc([min(times), max(times)]) if times else [None, None]
    return {
        "type": "Collection",
        "stac_version": VERSION,
        "stac_extensions": _EXTENSIONS,
        "id": record.slug,
        "title": record.name,
        "description": record.description or f"Photos of {record.name}",
        "license": "other",  # items have those of photos from services
        "providers": [{"name": request.host, "roles": ["host"], "url": request.host_url}],
        "extent": {
            "spatial": {"bbox": [map_box(record) or _WORLD]},
            "temporal": {"interval": [span]},
        },
    }


def _before(session: Session, query: ItemQuery, *, scope: Scope) -> str | None:
    """Return where the page before that of a search begins, as `Found.before`."""
    if not query.after:
        return None
    slug, after = _split(query.after)
    records = reversed([record for record in visible() if record.slug <= slug])
    numbers = ((record.slug, _numbers(session, record, query, scope=scope)) for record in records)
    return _last_page(((of, ids[ids <= after] if of == slug else ids) for of, ids in numbers), query.limit)


def _last_page(earlier: Iterable[tuple[str, NDArray[np.int64]]], limit: int) -> str | None:
    """Return where the last page of what comes before a page begins, as `Found.before`.

    Args:
        earlier: Names of maps with sorted numbers of photos, the last map first.
    """
    room = limit
    for slug, ids in earlier:
        if len(ids) > room:
            return f"{slug}-{ids[len(ids) - room - 1]}"
        room -= len(ids)
    return None if room == limit else ""


def _neighbours(session: Session, record: MapRecord, ids: list[int]) -> dict[int, dict[str, int]]:
    """Return the photos before and after some photos by time; those without a time are at the end."""
    known = {id: time_s for id, time_s in photo_times(session, record).items() if math.isfinite(time_s)}
    placed = (dot.id for dot in maps.dots(session, record, placed=True))
    order = sorted(placed, key=lambda id: (known.get(id, math.inf), id))
    found: dict[int, dict[str, int]] = {id: {} for id in ids}
    for one, following in pairwise(order):
        if one in found:
            found[one]["next"] = following
        if following in found:
            found[following]["prev"] = one
    return found


def _items(session: Session, record: MapRecord, ids: list[int]) -> Iterator[dict[str, Any]]:
    found = georeference(record)
    if found is None or not ids:
        return
    around = _neighbours(session, record, ids)
    beside = {id for pair in around.values() for id in pair.values()}
    read = {row[0].id: row for row in placed_photos(session, record, sorted(beside.union(ids)))}
    places = {id: _place(e, found) for id, (_photo, e, _floor) in read.items()}
    for photo, e, floor in (read[id] for id in ids if id in read):
        properties = {**_times(photo), **_facts(photo, e, found), "geovisio:status": "ready"}
        if floor is not None:
            properties |= {"expmap:floor": floor.name, "expmap:level": floor.level}
        yield {
            "type": "Feature",
            "stac_version": VERSION,
            "stac_extensions": _EXTENSIONS,
            "id": f"{record.slug}-{photo.id}",
            "collection": record.slug,
            **places[photo.id],
            "properties": {name: value for name, value in properties.items() if value is not None}
            | ({"datetime": None} if properties["datetime"] is None else {}),
            "assets": _assets(record.slug, photo, e),
            "links": [
                {
                    "rel": rel,
                    "id": f"{record.slug}-{id}",  # readers of Panoramax take this and the geometry
                    "geometry": places[id]["geometry"],
                }
                for rel, id in around[photo.id].items()
                if id in places
            ],
        }


def _place(e: Experience, found: Georeference) -> dict[str, Any]:
    at = place_of(e.position, found)
    if at is None:
        return {"geometry": None}
    lon, lat = round(at.lon, 9), round(at.lat, 9)
    return {"geometry": {"type": "Point", "coordinates": [lon, lat]}, "bbox": [lon, lat, lon, lat]}


def _times(photo: Photo) -> dict[str, str | None]:
    """Return its time in UTC; where that is unknown, the span in which it must be."""
    taken_s = math.nan if photo.taken_at is None else unix_time(photo.taken_at)
    created = utc([photo.uploaded_at.timestamp()])[0]
    if math.isfinite(taken_s):
        return {"datetime": utc([taken_s])[0], "datetimetz": photo.taken_at, "created": created}
    return {"datetime": None, "start_datetime": _OLDEST, "end_datetime": created, "created": created}


def _facts(photo: Photo, e: Experience, found: Georeference) -> dict[str, Any]:
    camera: dict[str, Any] = {"sensor_array_dimensions": [photo.width, photo.height]}
    if photo.camera:
        camera["camera_model"] = photo.camera
    if e.fov_deg is not None:
        camera["field_of_view"] = e.fov_deg
    facts: dict[str, Any] = {
        "title": photo.name,
        "description": e.note or None,
        "view:azimuth": None if e.heading_deg is None else e.heading_deg % 360.0,
        "pers:interior_orientation": camera,
        "quality:horizontal_accuracy": radius_of(e, found),
    }
    if e.source is not None:
        author = e.source.author or e.source.service
        producer = {"name": author, "roles": ["producer"]}
        facts |= {
            "license": _spdx(e.source.licence),
            "geovisio:producer": author,
            "providers": [producer | ({"url": e.source.url} if e.source.url else {})],
        }
    return facts


def _spdx(licence: str) -> str:
    """Return the identifier of a licence of Creative Commons or the like; any other text as it is.

    `CC BY-SA 4.0` is `CC-BY-SA-4.0`.
    """
    joined = "-".join(licence.split())
    return joined if _SPDX.fullmatch(joined) else "other"


def _assets(slug: str, photo: Photo, e: Experience) -> dict[str, dict[str, Any]]:
    """Return addresses of its pictures; the original, which is never blurred, only if nothing is."""
    wanted = [
        ("thumb", "thumb", "image/webp", "thumbnail", "256 pixels"),
        ("sd", "preview", "image/jpeg", "visual", "1600 pixels"),
    ]
    if not e.blurred:
        kind = _MEDIA_TYPES.get(PurePosixPath(photo.path).suffix.lower(), "image/jpeg")
        wanted.append(("hd", "original", kind, "data", "Original"))
    return {
        name: {
            "href": url_for(f"api_photos.{view}", slug=slug, id=photo.id, _external=True),
            "type": kind,
            "roles": [role],
            "title": title,
        }
        for name, view, kind, role, title in wanted
    }


def _numbers(session: Session, record: MapRecord, query: ItemQuery, *, scope: Scope) -> NDArray[np.int64]:
    named = scope.numbers(record.slug)
    if named is not None and not named:
        return np.empty(0, np.int64)
    ids = wanted_photos(session, record, query)
    return ids if named is None else ids[np.isin(ids, list(named))]


def _split(id: str) -> tuple[str, int]:
    """Return the map and the number in the id of an item; -1 if it has none."""
    slug, _, number = id.rpartition("-")
    is_number = number.isascii() and number.isdecimal() and len(number) <= 10 and int(number) <= MAX_NUMBER
    return (slug, int(number)) if is_number else (id, -1)
