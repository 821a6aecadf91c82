"""Pages of maps: the list, the bin, and the editor and settings of a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from flask import Blueprint, flash, redirect, render_template, request, url_for
from flask_babel import gettext as _
from flask_babel import lazy_gettext as _l
from sqlalchemy.orm import Session
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, UsageError
from webapp.store.accounts import accounts
from webapp.store.list_parts import ListPart, is_cursor
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.maps.maps import Role
from webapp.store.operate import jobs
from webapp.store.schema import Account, MapRecord
from webapp.web import errors
from webapp.web.context import account, library, open_map, reading_map
from webapp.web.fields import MOST_SEARCHED, split, wanted_part
from webapp.web.maps import state as map_state
from webapp.web.pages import Tab, back, page, text
from webapp.web.satellite.layers import offered_layers

blueprint = Blueprint("map_pages", __name__)

_PAGE = 48
"""Maps per page of the list."""
_MOST_DOTS = 200
"""Maximum number of dots in the preview of a map."""


@dataclass(frozen=True, slots=True)
class MapCard:
    map: MapRecord
    role: Role | None  # Role of the caller
    photos: int
    placed: int
    dots: str  # Data of an SVG path: a dot for each photo, or for some of them if there are many


@blueprint.get("/")
@page()
def index() -> str:
    """List the maps that are shared with the caller, in pages."""
    with library().database.read() as session:
        listed = _listed(session, account(), binned=False)
        binned = maps.count_binned(session, account())
    return render_template("maps/index.html", **listed, binned=binned)


@blueprint.get("/new")
@page()
def new() -> str:
    """Show the form for a new map, which begins with photos."""
    return render_template("maps/new.html")


@blueprint.get("/bin")
@page()
def show_bin() -> str:
    """List the maps in the bin, in pages."""
    with library().database.read() as session:
        listed = _listed(session, account(), binned=True)
    return render_template("maps/bin.html", **listed)


def _listed(session: Session, who: Account, *, binned: bool) -> dict[str, Any]:
    """Read the page of the list that the query string selects, and where the next one begins."""
    search, after = request.args.get("search", ""), request.args.get("after")
    if len(search) > MOST_SEARCHED or (after is not None and not is_cursor(after)):
        raise UsageError("this part of the list does not exist", hint="open the list again")
    limit = None if "whole" in request.args else _PAGE
    part = wanted_part({"bin": binned, "search": search, "after": after, "limit": limit})
    shown, last = split(maps.list_maps(session, who, part=ListPart(**part)), limit)
    more = {"search": search or None, "after": maps.cursor(last).text()} if last else None
    return {"cards": _cards(session, shown, who=who), "search": search, "more": more}


def _cards(session: Session, records: list[MapRecord], *, who: Account) -> list[MapCard]:
    roles, counts = maps.roles_of(session, records, account=who), maps.counts_of(session, records)
    dots = maps.some_positions(session, records, most=_MOST_DOTS)
    return [
        MapCard(
            record,
            roles.get(record.id),
            *counts[record.id],
            "".join(f"M{x:.0f} {y:.0f}h0" for x, y in dots[record.id]),
        )
        for record in records
    ]


@blueprint.get("/maps/<slug>/")
def show_slash(slug: str) -> Response:
    """Redirect to the URL without the slash."""
    return redirect(url_for("map_pages.show", slug=slug))


@blueprint.get("/maps/<slug>")
def show(slug: str) -> Response:
    """Redirect from the URL of a map to its editor."""
    return redirect(url_for("map_pages.editor", slug=open_map(slug).slug))


@blueprint.get("/maps/<slug>/edit")
@page(chapter="make-a-map#3-place", tab=Tab(_l("Edit"), "pin", order=1))
def editor(slug: str) -> str:
    """Show the editor, with the map's state embedded in the page; it is read-only for viewers."""
    with reading_map(slug) as (session, record):
        state = map_state.of_page(session, record, account=account())
    return render_template(
        "maps/editor.html",
        map=record,
        state=state,
        written=map_state.written_facts(),
        services=offered_layers(),
    )


@blueprint.get("/maps/<slug>/settings")
@page(chapter="sharing", tab=Tab(_l("Settings"), "settings", order=7))
def settings(slug: str) -> str:
    """Show the settings; only owners can change them."""
    return _settings_page(open_map(slug))


@blueprint.post("/maps/<slug>/settings/name")
def rename(slug: str) -> Response | tuple[str, int]:
    """Change name and, if it is sent, description of the map; its URL stays the same."""
    record = open_map(slug, "owner")
    try:
        with library().database.write() as db:
            row = db.get_one(MapRecord, record.id)
            maps.rename(row, text("name"), description=request.form.get("description"))
    except ExpMapError as error:
        return _settings_page(record, error=error), errors.status_of(error)
    flash(_("Saved."), "success")
    return back("map_pages.settings", slug=slug)


@blueprint.post("/maps/<slug>/settings/calibration")
def set_calibration(slug: str) -> Response:
    """Choose whether photos added from answers are real queries; if that is new, calibrate the map again."""
    record, wanted = open_map(slug, "owner"), "adopted" in request.form
    with library().database.write() as db:
        row = db.get_one(MapRecord, record.id)
        again = row.uses_adopted != wanted and maps.counts(db, row)[1] > 0
        row.uses_adopted = wanted
        if again:
            jobs.enqueue(db, INDEX_JOB, map_id=record.id)
    said = _("Saved. The map is calibrated again in the background.") if again else _("Saved.")
    flash(said, "success")
    return back("map_pages.settings", slug=slug)


@blueprint.post("/maps/<slug>/settings/leave")
def leave(slug: str) -> Response | tuple[str, int]:
    """Remove the caller from the members of the map."""
    record = open_map(slug)
    try:
        with library().database.write() as db:
            accounts.remove_member(db, record, account=db.get_one(Account, account().id))
    except ExpMapError as error:
        return _settings_page(record, error=error), errors.status_of(error)
    flash(_("The map is no longer shared with you."), "success")
    return back("map_pages.index")


def _settings_page(record: MapRecord, *, error: ExpMapError | None = None) -> str:
    with library().database.read() as session:
        shared = accounts.members_of(session, record)
        role = maps.role_of(session, record, account=account())
    return render_template(
        "maps/settings.html",
        map=record,
        members=shared,
        is_owner=role == "owner",
        error=error,
    )
