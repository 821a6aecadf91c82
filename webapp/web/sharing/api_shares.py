"""API of sharing a map: links to the map or to one answer, and members."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested, String
from apiflask.validators import OneOf
from flask import url_for
from markupsafe import escape

from webapp.errors import NotFound
from webapp.store import sharing
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.schema import Account, MapRecord, Share
from webapp.store.sharing import SharePermissions
from webapp.tasks.localize.index_location import has_landmarks
from webapp.web.context import account, library, map_role, open_map
from webapp.web.fields import LATER, Boolean, RecordNumber

shares_api = APIBlueprint("api_shares", __name__, url_prefix="/api/v1/maps/<slug>/shares", tag="Sharing")
members_api = APIBlueprint("api_members", __name__, url_prefix="/api/v1/maps/<slug>/members", tag="Sharing")

_ID = "<id:id>"
_FRAME = '<iframe src="{}" title="{}" width="800" height="600" loading="lazy"></iframe>'


class AllowsIn(Schema):
    """Contents of the share in addition to the image, the positions of photos, and its answer."""

    photos = Boolean(load_default=False, metadata={"description": "Pictures of photos, without EXIF."})
    localize = Boolean(
        load_default=False,
        metadata={"description": "Visitors may ask about photos of their own; of a shared map only."},
    )
    originals = Boolean(
        load_default=False,
        metadata={"description": "Original files, with names, times and GPS."},
    )
    notes = Boolean(
        load_default=False,
        metadata={"description": "Notes on photos and on spots; of a shared map only."},
    )
    landmarks = Boolean(
        load_default=False,
        metadata={"description": "The map in 3D: landmarks and cameras; of a shared map only."},
    )
    contribute = Boolean(
        load_default=False,
        metadata={
            "description": "Visitors may give photos, which wait for a decision; of a shared map only."
        },
    )


class ShareIn(AllowsIn):
    """A new share: of the map or an answer, public or secret."""

    query = RecordNumber(
        load_default=None, metadata={"description": "Id of the only answer to share; null: the map."}
    )
    public = Boolean(load_default=False, metadata={"description": "Whether it is listed for everybody."})


class ShareOut(Schema):
    """A share."""

    id = Integer()
    query = Integer(allow_none=True)
    public = Boolean()
    photos = Boolean()
    localize = Boolean()
    originals = Boolean()
    notes = Boolean()
    landmarks = Boolean()
    contribute = Boolean()
    maker = String(
        allow_none=True, metadata={"description": "Who made it; null where that account was removed."}
    )
    created_at = String()
    url = String(
        allow_none=True, metadata={"description": "Its address; of a secret one it is shown only once."}
    )
    embed = String(allow_none=True, metadata={"description": "HTML that shows it in a page elsewhere."})


class ShareList(Schema):
    """The shares of a map and of its answers, the newest first."""

    shares = List(Nested(ShareOut))
    in_3d = Boolean(metadata={"description": "Whether the map has landmarks, which a share can include."})


@shares_api.get("")
@shares_api.output(ShareList)
def list_shares(slug: str) -> dict[str, Any]:
    """List the shares of a map."""
    record = open_map(slug, "owner")
    with library().database.read() as session:
        return {
            "shares": [
                _share_json(record, share, maker=sharing.creator_of(session, share))
                for share in sharing.list_shares(session, record)
            ],
            "in_3d": has_landmarks(library().cfg(slug)),
        }


@shares_api.post("")
@map_role("owner")
@shares_api.input(ShareIn, arg_name="data")
@shares_api.output(ShareOut, status_code=201)
def create(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Share the map or one answer; the URL of a secret link is only in this response."""
    record = open_map(slug, "owner")
    with library().database.write() as session:
        share, token = sharing.create(
            session,
            record,
            allows=_allows(data),
            account_id=account().id,
            query_id=data["query"],
            public=data["public"],
        )
    return _share_json(record, share, maker=account().name, token=token)


@shares_api.patch(f"/{_ID}")
@map_role("owner")
@shares_api.input(AllowsIn, arg_name="data")
@shares_api.output(ShareOut)
def change(slug: str, id: int, data: dict[str, bool]) -> dict[str, Any]:
    """Change the contents of a share; its URL stays the same."""
    record = open_map(slug, "owner")
    with library().database.write() as session:
        share = sharing.find(session, record, id)
        sharing.change(share, _allows(data))
        return _share_json(record, share, maker=sharing.creator_of(session, share))


@shares_api.delete(f"/{_ID}")
@shares_api.output({}, status_code=204)
def revoke(slug: str, id: int) -> str:
    """Revoke a share; its URL becomes invalid."""
    record = open_map(slug, "owner")
    with library().database.write() as session:
        session.delete(sharing.find(session, record, id))
    return ""


def _allows(data: dict[str, Any]) -> SharePermissions:
    return SharePermissions(**{name: data[name] for name in SharePermissions.__slots__})


def _share_json(
    record: MapRecord, share: Share, *, maker: str | None, token: str | None = None
) -> dict[str, Any]:
    token = token or share.public_token
    return {
        "id": share.id,
        "query": share.query_id,
        "public": share.public_token is not None,
        "photos": share.photos,
        "localize": share.localize,
        "originals": share.originals,
        "notes": share.notes,
        "landmarks": share.landmarks,
        "contribute": share.contribute,
        "maker": maker,
        "created_at": share.created_at.isoformat(timespec="seconds"),
        "url": None if token is None else url_for("public_pages.show", token=token, _external=True),
        "embed": None if token is None else _embed(record, token),
    }


def _embed(record: MapRecord, token: str) -> str:
    return _FRAME.format(
        escape(url_for("public_pages.embed", token=token, _external=True)), escape(record.name)
    )


class MemberIn(Schema):
    """A member to add, or a new role of a member."""

    name = String(
        required=True,
        validate=LATER,
        metadata={"description": "Of an account; capital letters do not matter."},
    )
    role = String(required=True, validate=OneOf(maps.ROLES))


class MemberOut(Schema):
    """A member of the map."""

    account = Integer(metadata={"description": "Id."})
    name = String()
    role = String(validate=OneOf(maps.ROLES))


class MemberList(Schema):
    """The members of the map, by name; owners of the library have access to every map."""

    members = List(Nested(MemberOut))


@members_api.get("")
@members_api.output(MemberList)
def list_members(slug: str) -> dict[str, Any]:
    """List the members of a map."""
    record = open_map(slug)
    with library().database.read() as session:
        return {
            "members": [
                _member_as_json(person, role) for person, role in accounts.members_of(session, record)
            ]
        }


@members_api.post("")
@map_role("owner")
@members_api.input(MemberIn, arg_name="data")
@members_api.output(MemberOut)
def set_role(slug: str, data: dict[str, str]) -> dict[str, Any]:
    """Share the map with a person, or change a person's role."""
    record = open_map(slug, "owner")
    with library().database.write() as session:
        person = accounts.named(session, data["name"])
        accounts.set_member_role(session, record, account=person, role=data["role"])
    return _member_as_json(person, data["role"])


@members_api.delete("/<id:account_id>", endpoint="remove")
@members_api.output({}, status_code=204)
def remove_member(slug: str, account_id: int) -> str:
    """Stop sharing the map with a person; members may also remove themselves."""
    leaving = account_id == account().id
    record = open_map(slug, "viewer" if leaving else "owner")
    with library().database.write() as session:
        person = session.get(Account, account_id)
        if person is None:
            raise NotFound("account not found")
        accounts.remove_member(session, record, account=person)
    return ""


def _member_as_json(person: Account, role: str) -> dict[str, Any]:
    return {"account": person.id, "name": person.name, "role": role}
