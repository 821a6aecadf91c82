"""Who may use a map, and how."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested, String
from apiflask.validators import OneOf

from webapp.errors import NotFound
from webapp.store.accounts import accounts, members
from webapp.store.maps import maps
from webapp.store.schema import Account
from webapp.web.context import account, library, open_map

blueprint = APIBlueprint("api_members", __name__, url_prefix="/api/v1/maps/<slug>/members", tag="Sharing")


class MemberIn(Schema):
    """Whom the map is shared with."""

    name = String(required=True, metadata={"description": "Of an account; capital letters do not matter."})
    role = String(required=True, validate=OneOf(maps.ROLES))


class MemberOut(Schema):
    """An account that may use the map."""

    account = Integer(metadata={"description": "Id."})
    name = String()
    role = String(validate=OneOf(maps.ROLES))


class MemberList(Schema):
    """Who may use the map, by name; who owns the library may use every map."""

    members = List(Nested(MemberOut))


@blueprint.get("")
@blueprint.output(MemberList)
def list_members(slug: str) -> dict[str, Any]:
    """List who may use a map."""
    record = open_map(slug)
    with library().database.read() as session:
        return {"members": [_told(person, role) for person, role in members.listed(session, record)]}


@blueprint.post("")
@blueprint.input(MemberIn, arg_name="wish")
@blueprint.output(MemberOut)
def set_role(slug: str, wish: dict[str, str]) -> dict[str, Any]:
    """Share the map with somebody, or change what somebody may do."""
    record = open_map(slug, "owner")
    with library().database.write() as session:
        person = accounts.named(session, wish["name"])
        members.set_role(session, record, account=person, role=wish["role"])
    return _told(person, wish["role"])


@blueprint.delete("/<int(max=2147483647):account_id>")
@blueprint.output({}, status_code=204)
def remove(slug: str, account_id: int) -> str:
    """Share the map with somebody no longer; everybody may leave by themselves."""
    leaving = account_id == account().id
    record = open_map(slug, "viewer" if leaving else "owner")
    with library().database.write() as session:
        person = session.get(Account, account_id)
        if person is None:
            raise NotFound("there is no such account")
        members.remove(session, record, account=person)
    return ""


def _told(person: Account, role: str) -> dict[str, Any]:
    return {"account": person.id, "name": person.name, "role": role}
