"""Pages of missions: the list, a live mission on its map, and shared missions with their files."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint
from flask import Blueprint, Response, render_template

from webapp.errors import NotFound
from webapp.extras import is_installed
from webapp.missions.core.trajectory.symbols import SYMBOLS, svg_path
from webapp.missions.files.track_reader import FORMATS, accepted, called
from webapp.missions.store import missions, phones, shares
from webapp.missions.store.shares import OpenedMission
from webapp.missions.tasks import fuse
from webapp.missions.tasks.covering_maps import covering_maps, image_box
from webapp.missions.web import api_exports
from webapp.missions.web import state as mission_state
from webapp.missions.web.api_exports import ExportQuery, LinkQuery
from webapp.missions.web.context import open_mission
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.web import errors
from webapp.web.accounts.security import allow_framing
from webapp.web.context import account, authorized_by, library, public
from webapp.web.pages import page
from webapp.web.satellite.api_satellite import service_json
from webapp.web.satellite.layers import configured_layers

mission_pages = Blueprint("mission_pages", __name__, url_prefix="/missions")
phone_pages = Blueprint("phone_pages", __name__, url_prefix="/p")
public_pages = APIBlueprint("public_mission_pages", __name__, url_prefix="/m/<token>", enable_openapi=False)

_SIGNS = {
    "symbols": [
        {
            "pattern": one.pattern,
            "frame": svg_path((one.frame.outline,), closed=True),
            "fill": one.frame.fill,
            "glyph": svg_path(one.glyph),
        }
        for one in SYMBOLS
    ]
}
"""The symbols of objects, for the scripts of the pages."""

_FIRST_NAMED = ("gpx", "kml", "kmz", "fit", "tcx")
"""Formats of walks, by the programs and devices that people have."""

_by_link = authorized_by(lambda token, **_: _opened(token))
_SECRET = {"X-Robots-Tag": "noindex, nofollow"}


@mission_pages.get("")
@page(chapter="missions")
def index() -> str:
    """Show the page of the list of missions, which is loaded from the API."""
    return _list(binned=False)


@mission_pages.get("/bin")
@page(chapter="missions")
def show_bin() -> str:
    """Show the page of the missions in the bin."""
    return _list(binned=True)


@mission_pages.get("/<id:mission_id>")
@page(chapter="missions")
def show(mission_id: int) -> str:
    """Show a mission; scripts overlay others by `?with=2,3`."""
    mission, who = open_mission(mission_id), account()
    with library().database.read() as session:
        role = missions.role_of(session, mission, account=who)
        below = [{"slug": one.slug, "name": one.name} for one in covering_maps(session, mission, account=who)]
        fusion = fuse.last_job(session, mission, account_id=who.id)
    services = [*map(service_json, configured_layers())]
    page = {"id": mission.id, "services": services, "maps": below, "formats": _formats(), **_SIGNS}
    page["fusion"] = None if fusion is None or fusion.state in ("done", "cancelled") else fusion.id
    return render_template("missions/show.html", mission=mission, role=role, page=page)


def _list(*, binned: bool) -> str:
    who = account()
    with library().database.read() as session:
        records = maps.list_maps(session, who)
        roles = maps.roles_of(session, records, account=who)
        found = [
            {"slug": one.slug, "name": one.name, "box": _box(one, role=roles.get(one.id))} for one in records
        ]
        in_bin = missions.count_binned(session, who)
    page = {"maps": found, "binned": binned, "formats": _formats()}
    return render_template("missions/index.html", page=page, in_bin=in_bin, unreadable=_unreadable())


def _box(record: MapRecord, *, role: str | None) -> list[float] | None:
    """Return the box around a map's image as JSON, if missions may be added to the map."""
    box = image_box(record) if role in ("owner", "editor") else None
    return None if box is None else [round(side, 7) for side in box]


def _formats() -> dict[str, str]:
    """Return what the import dialog says and accepts."""
    readable = [entry for entry in FORMATS.values() if not entry.needs or is_installed(entry.needs)]
    readable.sort(key=lambda entry: (*_FIRST_NAMED, entry.name).index(entry.name))
    return {"accept": accepted(), "names": ", ".join(called(readable))}


def _unreadable() -> dict[str, str]:
    """Return the extras that are not installed, and the formats that need each."""
    missing = sorted({e.needs for e in FORMATS.values() if e.needs and not is_installed(e.needs)})
    return {need: ", ".join(called(e for e in FORMATS.values() if e.needs == need)) for need in missing}


@phone_pages.get("/<token>")
@public
@page(chapter="missions")
def send_positions(token: str) -> tuple[str, int, dict[str, str]]:
    """Show the page that sends the position of the phone that it is open on."""
    try:
        with library().database.read() as session:
            opened = phones.open_phone(session, token)
    except NotFound as error:
        return _gone(error, framed=False)
    data = {"token": token, "ended": opened.mission.ended_at is not None}
    text = render_template(
        "missions/phone.html", mission=opened.mission, phone=opened.phone, page=data, framed=False
    )
    return text, 200, _SECRET


@public_pages.get("")
@public
def shared(token: str) -> tuple[str, int, dict[str, str]]:
    """Show a shared mission."""
    return _page(token, framed=False)


@public_pages.get("/embed")
@public
def embedded(token: str) -> tuple[str, int, dict[str, str]]:
    """Show a shared mission in a frame of another site, without sign-in, cookies or actions."""
    allow_framing()
    return _page(token, framed=True)


@public_pages.get("/export.<string(maxlength=20):ending>")
@public
@_by_link
@public_pages.input(ExportQuery, location="query", arg_name="query")
def export(token: str, ending: str, *, query: dict[str, Any]) -> Response:
    """Export a shared mission; `?points=` limits the poses of each track."""
    opened = _opened(token)
    return api_exports.export(opened.mission.id, ending=ending, query=query, photos=bool(opened.share.photos))


@public_pages.get("/objects.csv")
@public
@_by_link
def objects(token: str) -> Response:
    """Export the objects of a shared mission."""
    return api_exports.export(_opened(token).mission.id, ending="objects.csv")


@public_pages.get("/link.kml")
@public
@_by_link
@public_pages.input(LinkQuery, location="query", arg_name="query")
def network_link(token: str, query: dict[str, int]) -> Response:
    """Get a KML link that programs fetch every `?every=` seconds."""
    mission = _opened(token).mission
    return api_exports.link(mission.name, token=token, every=query["every"])


def _page(token: str, *, framed: bool) -> tuple[str, int, dict[str, str]]:
    try:
        with library().database.read() as session:
            opened = shares.open_share(session, token)
            state = mission_state.shared_mission(session, opened, token=token)
    except NotFound as error:
        return _gone(error, framed=framed)
    page = {
        "id": state["id"],
        "token": token,
        "photos": opened.share.photos,
        "services": [],
        "maps": [],
        **_SIGNS,
    }
    text = render_template(
        "missions/shared.html", mission=opened.mission, page=page, token=token, framed=framed, role="visitor"
    )
    return text, 200, {} if opened.share.public_token else _SECRET


def _gone(error: NotFound, *, framed: bool) -> tuple[str, int, dict[str, str]]:
    return render_template("sharing/gone.html", error=error, framed=framed), errors.status_of(error), _SECRET


def _opened(token: str) -> OpenedMission:
    with library().database.read() as session:
        return shares.open_share(session, token)
