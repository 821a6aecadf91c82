"""The list of missions, and the page of one: its tracks and objects on the map, live."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.missions.store import missions
from webapp.missions.web.context import open_mission
from webapp.net.services import TileService, tile_services
from webapp.store.maps import maps
from webapp.web.accounts.security import allow_images
from webapp.web.context import account, library, settings
from webapp.web.satellite.api_satellite import service_json

blueprint = Blueprint("mission_pages", __name__, url_prefix="/missions")


@blueprint.get("")
def index() -> str:
    """List the missions; the list itself comes from the API."""
    return _list(binned=False)


@blueprint.get("/bin")
def trash() -> str:
    """List the missions in the bin."""
    return _list(binned=True)


@blueprint.get("/<int(max=2147483647):mission_id>")
def show(mission_id: int) -> str:
    """Show a mission; `?with=2,3` lays others over it."""
    mission, who = open_mission(mission_id), account()
    with library().database.read() as session:
        role = missions.role_of(session, mission, account=who)
    services = _services()
    allow_images(*sorted({service.origin for service in services}))
    page = {"id": mission.id, "services": [service_json(service) for service in services]}
    return render_template("missions/show.html", mission=mission, role=role, page=page)


def _list(*, binned: bool) -> str:
    who = account()
    with library().database.read() as session:
        found = [
            {"slug": record.slug, "name": record.name} for record in maps.listed(session, who, binned=False)
        ]
        in_bin = missions.count_binned(session, who)
    return render_template("missions/index.html", page={"maps": found, "binned": binned}, in_bin=in_bin)


def _services() -> tuple[TileService, ...]:
    """Give the tile services that the owner configured; without that, no page asks other hosts for tiles."""
    file = settings().tile_services
    return () if file is None else tile_services(file)
