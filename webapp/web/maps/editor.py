"""The page on which photos are put on the image of a map."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.store.schema import MapRecord
from webapp.web.context import account, library, open_map
from webapp.web.maps import state as map_state

blueprint = Blueprint("editor", __name__, url_prefix="/maps/<slug>")


@blueprint.get("/edit")
def show(slug: str) -> str:
    """Show the editor, with the state of the map in the page; who may only look finds nothing to change."""
    record, who = open_map(slug), account()
    with library().database.read() as session:
        state = map_state.whole(session, session.get_one(MapRecord, record.id), account=who)
    return render_template("maps/editor.html", map=record, tab="edit", state=state)
