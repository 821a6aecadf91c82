"""The page on which one walks through the photos of a map."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

from flask import Blueprint, render_template, request
from flask_babel import lazy_gettext as _l

from webapp.core.mapmodel.walk import Walk
from webapp.errors import UsageError
from webapp.store.maps.maps import count_without_time, days_with_photos
from webapp.tasks.maps.walk import stops_of, walk_along
from webapp.web.context import account, library, reading_map
from webapp.web.maps import state as map_state
from webapp.web.pages import Tab, page
from webapp.web.satellite.layers import offered_layers

blueprint = Blueprint("view_pages", __name__)

_DAYS = 30
"""Days per page of the timeline."""
_PHOTOS = 8
"""Photos of a map and day in it."""
_DATE = re.compile(r"\d{4}-\d\d-\d\d")


@blueprint.get("/maps/<slug>/view")
@page(chapter="view", tab=Tab(_l("View"), "eye", order=0))
def show(slug: str) -> str:
    """Show the photos of a map along their way; `?photo=ID` begins with one of them."""
    with reading_map(slug) as (session, record):
        state = map_state.of_page(session, record, account=account()) | {"can_edit": False}
        stops = stops_of(session, record)
    return render_template(
        "maps/view.html",
        map=record,
        state=state,
        walk=walk_json(walk_along(stops)),
        written=map_state.written_facts(),
        services=offered_layers(),
    )


@blueprint.get("/timeline")
@page(chapter="view#timeline")
def timeline() -> str:
    """List the days on which photos of all maps were taken; `?before=DAY` continues with earlier ones."""
    before = request.args.get("before")
    if before is not None and not _DATE.fullmatch(before):
        raise UsageError("this part of the list does not exist", hint="open the list again")
    with library().database.read() as session:
        found = days_with_photos(session, account(), before=before, most=_DAYS + 1, photos=_PHOTOS)
        shown = found[:_DAYS]
        return render_template(
            "view/timeline.html",
            days=shown,
            without_time=count_without_time(session, account()),
            earlier=shown[-1].date if len(found) > _DAYS else None,
            thumb=partial(map_state.picture_address, kind="thumb"),
        )


def walk_json(walk: Walk, *, times: bool = True) -> dict[str, Any]:
    """Return a walk for pages.

    Args:
        times: Whether the order in which the photos were taken may be known.

    Returns:
        `by_time`, `by_place`: ids; `steps`: by id, lists of id, bearing, and 1 for a turn on the spot.
    """
    return {
        "by_time": walk.by_time if times else (),
        "by_place": walk.by_place,
        "steps": {
            id: [[step.id, round(step.bearing_deg, 1), int(not step.distance)] for step in steps]
            for id, steps in walk.steps.items()
        },
    }
