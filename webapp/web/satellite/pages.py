"""The page on which the satellite image of a map and its georeference are set."""

from __future__ import annotations

from typing import Any, TypeVar

from flask import Blueprint, render_template
from flask_babel import lazy_gettext as _l

from webapp.core.geo.tilegrid import area_around
from webapp.core.geo.types import LatLon
from webapp.store.maps import maps
from webapp.store.operate import job_views
from webapp.store.operate.job_views import TILES_JOB
from webapp.store.schema import Job, MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.placing import RequestedPose, find_spots, image_of
from webapp.tasks.satellite.georeference import on_earth
from webapp.web.context import account, reading_map, settings
from webapp.web.maps.state import satellite_json
from webapp.web.operate.jobs import job_json
from webapp.web.pages import Tab, page
from webapp.web.satellite.api_satellite import service_json
from webapp.web.satellite.layers import offered_layers

blueprint = Blueprint("satellite_pages", __name__)

T = TypeVar("T")

_MOST_DRAWN = 1000
"""Maximum number of photo positions that a page gets; larger numbers are thinned evenly."""


@blueprint.get("/maps/<slug>/image")
@page(chapter="satellite", tab=Tab(_l("Image"), "image", order=3))
def show(slug: str) -> str:
    """Show the image, with the three ways of setting an image, and the three of setting a georeference."""
    geocoder = settings().geocoder
    with reading_map(slug) as (session, record):
        can_edit = maps.role_of(session, record, account=account()) in ("editor", "owner")
        photos = [photo for photo in maps.photos(session, record) if not photo.removed]
        jobs = job_views.shown(session, record.id)
        failed = [job_json(session, job, account=account()) for job in jobs if _has_failed(job)]
    services = offered_layers() if can_edit else ()
    placed = [photo for photo in photos if photo.x_px is not None]
    page = {
        "slug": record.slug,
        "revision": record.revision,
        "canEdit": can_edit,
        "satellite": satellite_json(record),
        "earth": _earth(record),
        "services": [service_json(service) for service in services],
        "photos": _where(photos),
        "placed": [(photo.x_px, photo.y_px) for photo in _thinned(placed)],
        "failure": failed[-1] if failed else None,
        "geocoder": None if geocoder.address is None else geocoder.attribution,
    }
    return render_template(
        "satellite/image.html",
        map=record,
        page=page,
        can_edit=can_edit,
        placed=len(placed),
        photos=len(photos),
        with_gps=sum(photo.gps_lat is not None for photo in photos),
        outside=_count_outside(record, photos),
    )


def _has_failed(job: Job) -> bool:
    return job.kind == TILES_JOB and job.state == "failed"


def _earth(record: MapRecord) -> dict[str, Any] | None:
    """Return the current georeference as JSON for the page."""
    found, image = georeference(record), image_of(record)
    if found is None or image is None:
        return None
    return {"method": found.method, **on_earth(found, width=image.width, height=image.height)}


def _count_outside(record: MapRecord, photos: list[Photo]) -> int:
    """Count the photos in the tray that were taken outside the image, by their GPS."""
    image = image_of(record)
    if image is None or image.georeference is None:
        return 0
    waiting = [p for p in photos if p.x_px is None and p.gps_lat is not None and p.gps_lon is not None]
    poses = [RequestedPose(p, LatLon(p.gps_lat or 0.0, p.gps_lon or 0.0)) for p in waiting]
    return sum(spot.problem is not None for spot in find_spots(image, poses))


def _where(photos: list[Photo]) -> dict[str, Any] | None:
    """Return the area around the photos' GPS positions, which is proposed for the image."""
    known = [(p.gps_lat, p.gps_lon) for p in photos if p.gps_lat is not None and p.gps_lon is not None]
    if not known:
        return None
    area = area_around(known)
    return {
        **area.box._asdict(),
        "all": len(photos),
        "gps": len(known),
        "far": area.outside,
        "positions": _thinned(known),
    }


def _thinned(items: list[T]) -> list[T]:
    """Thin items evenly to at most `_MOST_DRAWN`."""
    return items[:: max(1, -(-len(items) // _MOST_DRAWN))]
