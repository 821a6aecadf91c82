"""API for sharing a mission by link or publicly, for its owners."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested, String
from flask import url_for
from markupsafe import escape

from webapp.missions.store import missions
from webapp.missions.store import shares as mission_shares
from webapp.missions.store.schema import Mission, MissionShare
from webapp.missions.web.context import mission_role, open_mission
from webapp.store import sharing
from webapp.web.context import account, library
from webapp.web.fields import Boolean

blueprint = APIBlueprint(
    "api_mission_shares",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>/shares",
    tag="Sharing",
)

_ID = "<id:id>"
_FRAME = '<iframe src="{}" title="{}" width="800" height="600" loading="lazy"></iframe>'


class MissionAllows(Schema):
    """What a share shows in addition to tracks and objects."""

    photos = Boolean(
        load_default=False,
        metadata={"description": "Pictures of photos; never the files, nor what their EXIF says."},
    )


class MissionShareIn(MissionAllows):
    """A share to be created: public, or by a secret link."""

    public = Boolean(load_default=False, metadata={"description": "Whether it is listed for everybody."})


class MissionShareOut(Schema):
    """A share of a mission. Of a secret one, the addresses are shown only once."""

    id = Integer()
    public = Boolean()
    photos = Boolean()
    maker = String(
        allow_none=True, metadata={"description": "Who made it; null where that account was removed."}
    )
    created_at = String()
    url = String(allow_none=True, metadata={"description": "Its address."})
    embed = String(allow_none=True, metadata={"description": "HTML that shows it in a page elsewhere."})
    kml = String(
        allow_none=True, metadata={"description": "A KML link for other programs, which stays up to date."}
    )


OPERATIONS = {"api_mission_shares.list_shares": {"statuses": [403]}}


class MissionShareList(Schema):
    """The shares of a mission, newest first."""

    shares = List(Nested(MissionShareOut))


@blueprint.get("")
@blueprint.output(MissionShareList)
def list_shares(mission_id: int) -> dict[str, Any]:
    """List the shares of a mission."""
    mission = open_mission(mission_id, "owner")
    with library().database.read() as session:
        return {
            "shares": [
                _share_json(mission, share, maker=sharing.creator_of(session, share))
                for share in mission_shares.list_shares(session, mission)
            ]
        }


@blueprint.post("")
@mission_role("owner")
@blueprint.input(MissionShareIn, arg_name="data")
@blueprint.output(MissionShareOut, status_code=201)
def create(mission_id: int, data: dict[str, bool]) -> dict[str, Any]:
    """Share a mission; the addresses of a secret link are returned only here."""
    mission, who = open_mission(mission_id, "owner"), account()
    with library().database.write() as session:
        missions.find(session, mission.id, account=who, role="owner")  # it may have been moved to another map
        share, token = mission_shares.create(
            session, mission, photos=data["photos"], account_id=who.id, public=data["public"]
        )
    return _share_json(mission, share, maker=who.name, token=token)


@blueprint.patch(f"/{_ID}")
@mission_role("owner")
@blueprint.input(MissionAllows, arg_name="data")
@blueprint.output(MissionShareOut)
def change(mission_id: int, id: int, *, data: dict[str, bool]) -> dict[str, Any]:
    """Change what a share shows; its address stays the same."""
    mission = open_mission(mission_id, "owner")
    with library().database.write() as session:
        share = mission_shares.find(session, mission, id=id)
        share.photos = data["photos"]
        return _share_json(mission, share, maker=sharing.creator_of(session, share))


@blueprint.delete(f"/{_ID}")
@blueprint.output({}, status_code=204)
def revoke(mission_id: int, id: int) -> str:
    """Revoke a share: its addresses stop working."""
    mission = open_mission(mission_id, "owner")
    with library().database.write() as session:
        session.delete(mission_shares.find(session, mission, id=id))
    return ""


def _share_json(
    mission: Mission, share: MissionShare, *, maker: str | None, token: str | None = None
) -> dict[str, Any]:
    token = token or share.public_token

    def address(endpoint: str) -> str | None:
        return None if token is None else url_for(endpoint, token=token, _external=True)

    framed = address("public_mission_pages.embedded")
    return {
        "id": share.id,
        "public": share.public_token is not None,
        "photos": share.photos,
        "maker": maker,
        "created_at": share.created_at.isoformat(timespec="seconds"),
        "url": address("public_mission_pages.shared"),
        "embed": None if framed is None else _FRAME.format(escape(framed), escape(mission.name)),
        "kml": address("public_mission_pages.network_link"),
    }
