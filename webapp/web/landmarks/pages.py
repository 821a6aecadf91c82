"""The page that shows the landmarks of a map, from above and in space."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.web.context import account, library, open_map
from webapp.web.maps import state as map_state

blueprint = Blueprint("landmarks_pages", __name__)


@blueprint.get("/maps/<slug>/landmarks")
def show(slug: str) -> str:
    """Show the page; `?photo=ID` chooses a camera."""
    record = open_map(slug)
    with library().database.read() as session:
        record = session.get_one(MapRecord, record.id)
        role = maps.role_of(session, record, account=account())
        photos = maps.counts(session, record)[0]
        page = {
            "slug": record.slug,
            "can_edit": role in ("editor", "owner"),
            "satellite": map_state.satellite_json(record),
        }
    return render_template("maps/landmarks.html", map=record, tab="landmarks", page=page, photos=photos)
