"""Pages and files of shared missions for visitors, the same for frames, and a link for other programs."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint
from flask import Response, render_template

from webapp.errors import NotFound
from webapp.missions.store import shares
from webapp.missions.store.shares import OpenedMission
from webapp.missions.web import download, shared_state
from webapp.missions.web.download import ExportQuery, LinkQuery
from webapp.web import errors
from webapp.web.accounts.access import public
from webapp.web.accounts.security import allow_framing
from webapp.web.context import library

blueprint = APIBlueprint("public_mission_pages", __name__, url_prefix="/m/<token>", enable_openapi=False)

_SECRET = {"X-Robots-Tag": "noindex, nofollow"}


@blueprint.get("")
@public
def show(token: str) -> tuple[str, int, dict[str, str]]:
    """Show a shared mission."""
    return _page(token, framed=False)


@blueprint.get("/embed")
@public
def embed(token: str) -> tuple[str, int, dict[str, str]]:
    """Show it in a frame of another site: no sign-in, no cookie, nothing that could be done for somebody."""
    allow_framing()
    return _page(token, framed=True)


@blueprint.get("/export.<string(maxlength=20):ending>")
@public
@blueprint.input(ExportQuery, location="query", arg_name="query")
def export(token: str, ending: str, *, query: dict[str, Any]) -> Response:
    """Take a shared mission away; `?points=` thins its tracks."""
    mission = _opened(token).mission
    return download.export(mission.id, ending=ending, query=query)


@blueprint.get("/objects.csv")
@public
def objects(token: str) -> Response:
    """Take the objects of a shared mission away."""
    return download.export(_opened(token).mission.id, ending="objects.csv", query={"points": None})


@blueprint.get("/link.kml")
@public
@blueprint.input(LinkQuery, location="query", arg_name="query")
def network_link(token: str, query: dict[str, int]) -> Response:
    """Take a KML link away that programs fetch again and again, each `?every=` seconds."""
    mission = _opened(token).mission
    return download.link(mission.name, token=token, every=query["every"])


def _page(token: str, *, framed: bool) -> tuple[str, int, dict[str, str]]:
    try:
        with library().database.read() as session:
            opened = shares.opened(session, token)
            state = shared_state.whole(session, opened, token=token)
    except NotFound as error:
        gone = render_template("sharing/gone.html", error=error, framed=framed)
        return gone, errors.status_of(error), _SECRET
    page = {"id": state["id"], "token": token, "photos": opened.share.photos, "services": []}
    text = render_template(
        "missions/shared.html", mission=opened.mission, page=page, token=token, framed=framed, role="visitor"
    )
    return text, 200, {} if opened.share.public_token else _SECRET


def _opened(token: str) -> OpenedMission:
    with library().database.read() as session:
        return shares.opened(session, token)
