"""The page with the name of a map and with whom it is shared."""

from __future__ import annotations

from flask import Blueprint, flash, render_template
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError
from webapp.store.accounts import accounts, members
from webapp.store.maps import maps
from webapp.store.schema import Account, MapRecord
from webapp.web import errors
from webapp.web.context import account, library, open_map
from webapp.web.forms import back, text

blueprint = Blueprint("map_settings", __name__, url_prefix="/maps/<slug>/settings")


@blueprint.get("")
def show(slug: str) -> str:
    """Show the settings; only owners can change them."""
    return _page(open_map(slug))


@blueprint.post("/name")
def rename(slug: str) -> Response | tuple[str, int]:
    """Give the map another name; its address stays."""
    record = open_map(slug, "owner")
    try:
        with library().database.write() as db:
            db.get_one(MapRecord, record.id).name = maps.checked_name(text("name"))
    except ExpMapError as error:
        return _page(record, error=error), errors.status_of(error)
    flash(_("The map has been renamed."), "success")
    return back("map_settings.show", slug=slug)


@blueprint.post("/members")
def set_role(slug: str) -> Response | tuple[str, int]:
    """Share the map with somebody, or change what somebody may do."""
    record = open_map(slug, "owner")
    try:
        with library().database.write() as db:
            person = accounts.named(db, text("name"))
            members.set_role(db, record, account=person, role=text("role"))
    except ExpMapError as error:
        return _page(record, error=error), errors.status_of(error)
    flash(_("%(name)s now has access.", name=person.name), "success")
    return back("map_settings.show", slug=slug)


@blueprint.post("/members/<int:account_id>/remove")
def remove_member(slug: str, account_id: int) -> Response | tuple[str, int]:
    """Share the map with somebody no longer; everybody may leave by themselves."""
    leaving = account_id == account().id
    record = open_map(slug, "viewer" if leaving else "owner")
    try:
        with library().database.write() as db:
            person = db.get(Account, account_id)
            if person is not None:
                members.remove(db, record, account=person)
    except ExpMapError as error:
        return _page(record, error=error), errors.status_of(error)
    flash(_("The map is no longer shared with this person."), "success")
    return back("maps_page.index") if leaving else back("map_settings.show", slug=slug)


def _page(record: MapRecord, *, error: ExpMapError | None = None) -> str:
    with library().database.read() as session:
        shared = members.listed(session, record)
        role = maps.role_of(session, record, account=account())
    return render_template(
        "maps/settings.html",
        map=record,
        tab="settings",
        members=shared,
        is_owner=role == "owner",
        error=error,
    )
