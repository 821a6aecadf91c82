"""The page with the jobs of a map."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.store.maps import maps
from webapp.web.context import account, library, open_map

blueprint = Blueprint("jobs_page", __name__)


@blueprint.get("/maps/<slug>/jobs")
def show(slug: str) -> str:
    """Show what is worked on; the list itself comes from the API and is kept up to date."""
    record = open_map(slug)
    with library().database.read() as session:
        can_edit = maps.role_of(session, record, account=account()) in ("editor", "owner")
    return render_template("operate/jobs.html", map=record, tab="jobs", can_edit=can_edit)
