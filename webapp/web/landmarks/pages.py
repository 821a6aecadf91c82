"""The pages that show the landmarks of a map, and its control points."""

from __future__ import annotations

from flask import Blueprint, render_template
from flask_babel import lazy_gettext as _l

from webapp.core.mapmodel.control_points import TAG_FAMILIES
from webapp.render.sheet.options import PAPERS
from webapp.store.maps import maps
from webapp.web.context import account, reading_map
from webapp.web.maps import state as map_state
from webapp.web.maps.state import picture_address
from webapp.web.pages import Tab, page

blueprint = Blueprint("landmarks_pages", __name__)


@blueprint.get("/maps/<slug>/landmarks")
@page(chapter="landmarks#landmarks-in-3d", tab=Tab(_l("3D"), "cube", order=4))
def show(slug: str) -> str:
    """Show the landmarks; `?photo=ID` selects a camera."""
    with reading_map(slug) as (session, record):
        role = maps.role_of(session, record, account=account())
        photos = maps.counts(session, record)[0]
        page = {
            "slug": record.slug,
            "can_edit": role in ("editor", "owner"),
            "satellite": map_state.satellite_json(record),
            "originals": True,
        }
    return render_template("maps/landmarks.html", map=record, page=page, photos=photos)


@blueprint.get("/maps/<slug>/control-points")
@page(chapter="landmarks#control-points", tab="landmarks_pages.show")
def control_points(slug: str) -> str:
    """Show the control points, and the residuals of these and of the placed photos."""
    with reading_map(slug) as (session, record):
        role = maps.role_of(session, record, account=account())
        photos = [
            {
                "id": photo.id,
                "name": photo.name,
                "width": photo.width,
                "height": photo.height,
                "preview": picture_address(record, photo, kind="preview"),
            }
            for photo in maps.photos(session, record)
            if not photo.removed
        ]
        page = {
            "slug": record.slug,
            "can_edit": role in ("editor", "owner"),
            "satellite": map_state.satellite_json(record),
            "photos": photos,
        }
    choices = {"families": [*TAG_FAMILIES], "papers": PAPERS}
    return render_template("maps/control_points.html", map=record, page=page, **choices)
