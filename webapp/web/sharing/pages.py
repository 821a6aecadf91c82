"""Pages for visitors: a shared map or answer, also for embedding, and the list of public maps."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.errors import NotFound
from webapp.files.localize.models import NETWORKS, missing_networks
from webapp.store import sharing
from webapp.store.maps import maps
from webapp.store.sharing import OpenedShare
from webapp.tasks.localize.index_location import has_landmarks
from webapp.tasks.maps.walk import stops_of, walk_along
from webapp.web import errors
from webapp.web.accounts.security import allow_framing
from webapp.web.context import account, library, public, reading_map, settings
from webapp.web.localize.answers import answer_colours
from webapp.web.maps import state
from webapp.web.maps.state import written_facts
from webapp.web.maps.view import walk_json
from webapp.web.pages import page
from webapp.web.satellite.layers import offered_layers
from webapp.web.sharing import shared_state
from webapp.web.state import parts

blueprint = Blueprint("public_pages", __name__)
members = Blueprint("sharing_pages", __name__)

_Page = tuple[str, int, dict[str, str]]

_SECRET = {"X-Robots-Tag": "noindex, nofollow"}


@blueprint.get("/public")
@public
@page(chapter="sharing")
def index() -> str:
    """List all public shares."""
    with library().database.read() as session:
        more = {name: read(session) for name, read in parts().public_lists.items()}
        return render_template("sharing/public_maps.html", opened=sharing.public(session), **more)


@blueprint.get("/s/<token>")
@public
def show(token: str) -> _Page:
    """Show a shared map, or a shared answer; `?photo=ID` begins with a photo of the map."""
    return _page(token, framed=False)


@blueprint.get("/s/<token>/map")
@public
def show_map(token: str) -> _Page:
    """Show the image of a shared map with its dots, and localize photos if the share allows it."""
    return _page(token, framed=False, walks=False)


@blueprint.get("/embed/<token>")
@public
def embed(token: str) -> _Page:
    """Show a share in a frame of another site, without sign-in, cookies or any action on behalf of a user."""
    allow_framing()
    return _page(token, framed=True)


@blueprint.get("/s/<token>/landmarks")
@public
def show_landmarks(token: str) -> _Page:
    """Show the landmarks of a shared map, if the share includes them."""
    try:
        with library().database.read() as session:
            opened = shared_state.open_landmarks(session, token)
    except NotFound as error:
        return _gone(error, framed=False)
    about = shared_state.landmarks_page(opened, token=token)
    page = render_template(
        "sharing/shared_landmarks.html", page=about, can_walk=opened.share.photos, in_3d=True
    )
    return page, 200, _headers(opened)


@members.get("/maps/<slug>/contributions")
@page(chapter="contributions", tab="map_pages.editor")
def contributions(slug: str) -> str:
    """Show the photos from visitors that wait for a decision."""
    with reading_map(slug) as (session, record):
        role = maps.role_of(session, record, account=account())
        data = {
            "slug": record.slug,
            "can_edit": role in ("editor", "owner"),
            "satellite": state.satellite_json(record),
        }
    missing = missing_networks(settings().models)
    data["searches"] = len(missing) < len(NETWORKS)
    return render_template("sharing/contributions.html", map=record, page=data, missing=missing)


def _page(token: str, *, framed: bool, walks: bool = True) -> _Page:
    """Make the page of a share; with `walks`, View if the share includes photos of the map."""
    try:
        with library().database.read() as session:
            opened = sharing.open_share(session, token)
            whole = shared_state.of_page(session, opened, token=token)
            can_walk = opened.share.photos and opened.query is None and bool(whole["photos"])
            stops = stops_of(session, opened.map) if can_walk and walks else ()
    except NotFound as error:
        return _gone(error, framed=framed)
    page = render_template(
        "sharing/shared_view.html" if stops else "sharing/shared_map.html",
        opened=opened,
        state=whole,
        walk=walk_json(walk_along(stops), times=opened.share.originals) if stops else None,
        can_walk=can_walk,
        written=written_facts(),
        services=offered_layers(to_visitors=True) if whole["georeference"] else (),
        in_3d=opened.share.landmarks and has_landmarks(library().cfg(opened.map.slug)),
        colours=answer_colours(),
        framed=framed,
    )
    return page, 200, _headers(opened)


def _gone(error: NotFound, *, framed: bool) -> _Page:
    page = render_template("sharing/gone.html", error=error, framed=framed)
    return page, errors.status_of(error), _SECRET


def _headers(opened: OpenedShare) -> dict[str, str]:
    return {} if opened.share.public_token else _SECRET
