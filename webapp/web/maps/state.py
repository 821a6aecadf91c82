"""Maps as JSON, for pages and programs: the state, and the changes since a revision."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from flask_babel import gettext as _
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference, latlon_grid
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import EDITED, FACTS, WRITTEN, PhotoSource
from webapp.files.photos.photo import Kind, blur_key
from webapp.files.satellite.pyramid import max_zoom
from webapp.store.maps import edits, maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.maps.maps import Dot
from webapp.store.operate import job_views
from webapp.store.schema import Account, MapRecord, Photo, PlacedElsewhere
from webapp.tasks.maps.library_map import floors, georeference
from webapp.tasks.satellite import display
from webapp.tasks.satellite.files import source_of
from webapp.web import context
from webapp.web.operate.jobs import job_json
from webapp.web.state import library

FIRST_PHOTOS = 500
"""Number of photos embedded in a page with all details; the details of the others are fetched later."""
_DOT_DIGITS = 2
"""Decimal digits of pixels and degrees that are only drawn."""


def whole(session: Session, record: MapRecord, *, account: Account) -> dict[str, Any]:
    """Return the whole state of a map.

    Returns:
        `slug, name, role, can_edit, binned, revision, satellite, georeference, photos, placements, notes,
            floors, undo, redo`.
    """
    present = [p for p in maps.photos(session, record) if not p.removed]
    return {**_about(session, record, account=account), "photos": _photos(record, present)}


def of_page(session: Session, record: MapRecord, *, account: Account) -> dict[str, Any]:
    """Return the initial state for a page of a map, which fetches the other photos later.

    Returns:
        As `whole`, but with only the first `photos`, and `dots` for all others.
    """
    first = maps.first_photos(session, record, most=FIRST_PHOTOS)
    shown = {photo.id for photo in first}
    return {
        **_about(session, record, account=account),
        "photos": _photos(record, first),
        "dots": columns(dot for dot in maps.dots(session, record) if dot.id not in shown),
    }


def photos_after(session: Session, record: MapRecord, id: int, *, most: int) -> dict[str, Any]:
    """Return the photos after an id: `photos`, and `next`, the id to continue after, or None at the end."""
    found = maps.photos_after(session, record, id, most=most)
    return {"photos": _photos(record, found), "next": found[-1].id if len(found) == most else None}


def columns(dots: Iterable[Dot]) -> dict[str, list[float | None]]:
    """Return the drawn properties of photos as one list per field, which takes a tenth of the space."""
    found: dict[str, list[float | None]] = {name: [] for name in Dot._fields}
    for dot in dots:
        for values, value in zip(found.values(), dot, strict=True):
            values.append(value if value is None else round(value, _DOT_DIGITS))
    return found


def _about(session: Session, record: MapRecord, *, account: Account) -> dict[str, Any]:
    """Return the state of a map without its photos."""
    role = maps.role_of(session, record, account=account)
    return {
        "slug": record.slug,
        "name": record.name,
        "description": record.description,
        "role": role,
        "can_edit": role in ("owner", "editor"),
        "binned": record.binned_at is not None,
        "revision": record.revision,
        **image(record),
        "placements": _placements(session, record),
        "notes": notes_json(record),
        "floors": floors_json(record),
        **_history(session, record, account=account),
    }


def changes(session: Session, record: MapRecord, *, account: Account, since: int) -> dict[str, Any]:
    """Return the changes since a revision.

    Returns:
        `revision`, `photos` (the changed ones, removed ones as `{id, removed, revision}`), `undo`, `redo`,
            `jobs`; `satellite`, `georeference`, `placements`, `notes` and `floors` only if they may have
            changed.
    """
    changed = maps.photos(session, record, since=since)
    return {
        "revision": record.revision,
        **(image(record) if record.satellite_revision > since else {}),
        "photos": _changed(record, changed),
        **({"placements": _placements(session, record)} if changed else {}),
        **({"notes": notes_json(record), "floors": floors_json(record)} if record.revision > since else {}),
        **_history(session, record, account=account),
        "jobs": [job_json(session, job, account=account) for job in job_views.shown(session, record.id)],
    }


def edited(record: MapRecord, revision: int | None) -> dict[str, Any]:
    """Return the changes made by one edit, without concurrent edits, which `changes` returns.

    Args:
        revision: Revision of the edit; None if it changed nothing.

    Returns:
        `revision`, `photos` (those whose last change is this edit), `placements`, `notes`, `floors`, `undo`,
            `redo`; `satellite` and `georeference` only if it changed the image.
    """
    who = context.account()
    with library().database.read() as session:
        now = session.get_one(MapRecord, record.id)
        since = now.revision if revision is None else revision - 1
        changed = [p for p in maps.photos(session, now, since=since) if p.revision == revision]
        return {
            "revision": revision,
            **(image(now) if now.satellite_revision == revision else {}),
            "photos": _changed(now, changed),
            "placements": _placements(session, now),
            "notes": notes_json(now),
            "floors": floors_json(now),
            **_history(session, now, account=who),
        }


def _changed(record: MapRecord, photos: list[Photo]) -> list[dict[str, Any]]:
    gone = [{"id": p.id, "removed": True, "revision": p.revision} for p in photos if p.removed]
    return [*_photos(record, [p for p in photos if not p.removed]), *gone]


def summary(session: Session, record: MapRecord, *, account: Account) -> dict[str, Any]:
    return summaries(session, [record], account=account)[0]


def summaries(session: Session, records: Sequence[MapRecord], *, account: Account) -> list[dict[str, Any]]:
    """Return the entries of a list of maps, with a constant number of SQL statements."""
    roles = maps.roles_of(session, records, account=account)
    counts = maps.counts_of(session, records)
    return [
        {
            "slug": record.slug,
            "name": record.name,
            "role": roles.get(record.id),
            "photos": counts[record.id][0],
            "placed": counts[record.id][1],
            "changed_at": record.changed_at.isoformat(timespec="seconds"),
            "binned": record.binned_at is not None,
            "revision": record.revision,
        }
        for record in records
    ]


def image(record: MapRecord, *, base: str | None = None) -> dict[str, Any]:
    """Return a map's image and its georeference; `base` as for `satellite_json`.

    Returns:
        `satellite` and `georeference`, each None if the map has none.
    """
    found = georeference(record)
    size = (record.satellite_width or 0, record.satellite_height or 0)
    return {
        "satellite": satellite_json(record, base=base),
        "georeference": None if found is None or not all(size) else _georeference(record, found, size),
    }


def _georeference(record: MapRecord, found: Georeference, size: tuple[int, int]) -> dict[str, Any]:
    """Return the georeference as in `map.json`, with its scale and a sampled grid for pages."""
    grid = latlon_grid(found, size)
    scale = found.metres_per_pixel(MapPixel(size[0] / 2, size[1] / 2))
    return {
        **(record.georeference or {}),
        "metres_per_pixel": scale if np.isfinite(scale) else None,
        "latlon_grid": {"columns": grid.columns, "rows": grid.rows, "latlon": grid.latlon},
    }


def _photos(record: MapRecord, photos: list[Photo]) -> list[dict[str, Any]]:
    spots = _gps_spots(record, photos)
    return [_photo(record, photo, gps=spots.get(photo.id)) for photo in photos]


def _photo(record: MapRecord, photo: Photo, *, gps: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "id": photo.id,
        **facts_json(photo),
        "x_px": photo.x_px,
        "y_px": photo.y_px,
        "radius_px": photo.radius_px,
        "floor": photo.floor,
        "camera": photo.camera,
        "width": photo.width,
        "height": photo.height,
        "gps": gps,
        "gps_problem": photo.gps_problem,
        "file_notes": photo.file_notes or [],
        "revision": photo.revision,
        "preview": picture_address(record, photo, kind="preview"),
        "thumb": picture_address(record, photo, kind="thumb"),
    }


def picture_address(record: MapRecord, photo: Photo, *, kind: Kind) -> str:
    """Return the URL of a preview of a photo for members, which changes with what is blurred in it."""
    look = f"?look={blur_key(boxes_of(photo))}" if photo.blurred else ""
    return f"/api/v1/maps/{record.slug}/photos/{photo.id}/{kind}{look}"


def facts_json(photo: Photo) -> dict[str, Any]:
    """Return the facts of a photo; the accuracy of its GPS is in `gps`."""
    facts = {name: getattr(photo, name) for name in FACTS if name != "gps_accuracy_m"}
    return {**facts, "blurred": photo.blurred or [], "source": source_of_photo(photo)}


def written_facts() -> list[dict[str, Any]]:
    """Return the texts of photos that people edit, for pages, which have a field and a filter for each."""
    return [
        {
            "name": name,
            "kind": EDITED[name].kind,
            "label": _(FACTS[name].label),
            "most": form.most,
            "lines": form.lines,
        }
        for name, form in WRITTEN.items()
    ]


def notes_json(record: MapRecord) -> list[dict[str, Any]]:
    empty: dict[str, Any] = {"x_px": None, "y_px": None, "text": "", "photos": [], "floor": BASE_FLOOR}
    return [{**empty, **note} for note in record.notes or ()]


def floors_json(record: MapRecord, *, base: str | None = None) -> list[dict[str, Any]]:
    """Return the floors of a map, the lowest first; empty if the map has only its own image.

    Args:
        base: Base URL of the images; by default that for members of the map.

    Returns:
        `id`, `name`, `level`, `height_m`, `url` of an image that covers the map (null if the map's own image
            shows the floor), and `attribution`.
    """
    base = base or f"/api/v1/maps/{record.slug}/floors"
    return [_floor(record, floor, base=base) for floor in sorted(floors(record), key=lambda f: f.level)]


def _floor(record: MapRecord, floor: Floor, *, base: str) -> dict[str, Any]:
    key = display.floor_key(library(), record, floor=floor)
    folder = library().map_folder(record.slug)
    source = {} if floor.image is None else source_of(folder, floor.image.path)
    return {
        "id": floor.id,
        "name": floor.name,
        "level": floor.level,
        "height_m": floor.height_m,
        "url": None if key is None else f"{base}/{floor.id}/image?v={key}",
        "attribution": source.get("attribution"),
    }


def source_of_photo(photo: Photo) -> dict[str, str] | None:
    """Return the street-level source of a photo, with its credit line; None for members' own photos."""
    return None if photo.source is None else {**photo.source, "credit": PhotoSource(**photo.source).credit}


def _gps_spots(record: MapRecord, photos: list[Photo]) -> dict[int, dict[str, Any]]:
    """Return the GPS positions of photos by id, also in map pixels if the map has a georeference."""
    known = [p for p in photos if p.gps_lat is not None and p.gps_lon is not None]
    found = georeference(record) if known else None
    latlon = np.array([[p.gps_lat, p.gps_lon] for p in known], float).reshape(-1, 2)
    pixels = np.full((len(known), 2), np.nan) if found is None else found.pixel_from_latlon(latlon)
    spots = {}
    for photo, (x, y) in zip(known, pixels.tolist(), strict=True):
        on_map = found is not None and np.isfinite([x, y]).all()
        radius = None
        if on_map and found is not None and photo.gps_accuracy_m is not None:
            scale = found.metres_per_pixel(MapPixel(x, y))
            radius = photo.gps_accuracy_m / scale if np.isfinite(scale) and scale > 0 else None
        spots[photo.id] = {
            "lat": photo.gps_lat,
            "lon": photo.gps_lon,
            "accuracy_m": photo.gps_accuracy_m,
            "x_px": x if on_map else None,
            "y_px": y if on_map else None,
            "radius_px": radius,
        }
    return spots


def _placements(session: Session, record: MapRecord) -> list[dict[str, Any]]:
    found = select(PlacedElsewhere).where(PlacedElsewhere.map_id == record.id)
    positions: dict[str, dict[str, list[float]]] = {}
    for row in session.scalars(found.order_by(PlacedElsewhere.placement, PlacedElsewhere.photo_id)):
        positions.setdefault(row.placement, {})[str(row.photo_id)] = [row.x_px, row.y_px]
    return [{"name": name, "positions": at} for name, at in positions.items()]


def _history(session: Session, record: MapRecord, *, account: Account) -> dict[str, Any]:
    next_steps = edits.next_steps(session, record, account_id=account.id)
    return {way: None if step is None else asdict(step) for way, step in next_steps.items()}


def satellite_json(record: MapRecord, *, base: str | None = None) -> dict[str, Any] | None:
    """Return the URL and size of a map's image; None without one.

    Args:
        base: Base URL of the image; by default that for members of the map.

    Returns:
        `url`, `width`, `height`, `tiles` (`url` with {z}, {x} and {y}, and `max_zoom`) or null, and
            `attribution` or null. The URLs change with the content, so that browsers can cache the image.
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
