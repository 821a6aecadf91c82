"""The page that tells where a photo was taken."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.files.localize.models import usable_features, usable_methods
from webapp.store.schema import MapRecord
from webapp.web.context import account, library, open_map, settings
from webapp.web.localize.answer_colours import answer_colours
from webapp.web.maps import state as map_state

blueprint = Blueprint("localize", __name__, url_prefix="/maps/<slug>")


@blueprint.get("/localize")
def show(slug: str) -> str:
    """Show the page; `?query=ID` opens an earlier answer."""
    record, who = open_map(slug), account()
    with library().database.read() as session:
        state = map_state.whole(session, session.get_one(MapRecord, record.id), account=who)
    return render_template(
        "localize/localize.html",
        map=record,
        tab="localize",
        state=state,
        features=sorted(usable_features(settings().models)),
        methods=usable_methods(settings().models),
        colours=answer_colours(),
    )
