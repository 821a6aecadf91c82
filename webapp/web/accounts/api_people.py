"""The accounts of the library, for its owner."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested, String
from flask import url_for
from sqlalchemy.orm import Session

from webapp.errors import NotAllowed, NotFound
from webapp.store.accounts import accounts, sign_in
from webapp.store.schema import Account
from webapp.web.accounts.api_account import AccountOut, told
from webapp.web.context import account, library, settings

blueprint = APIBlueprint("api_people", __name__, url_prefix="/api/v1/accounts", tag="Accounts")

_ID = "<int(max=2147483647):account_id>"


class PersonIn(Schema):
    """An account to make."""

    name = String(required=True)


class SignInLinkOut(Schema):
    """A link that signs in once."""

    account = Integer(metadata={"description": "Id."})
    url = String(metadata={"description": "It is in this answer and nowhere else."})
    hours = Integer(metadata={"description": "How long it works."})


class AccountList(Schema):
    """All accounts, by name."""

    accounts = List(Nested(AccountOut))


@blueprint.before_request
def only_owners() -> None:
    """Let in who owns the library."""
    if not account().is_owner:
        raise NotAllowed("this is for the owner of the library")


@blueprint.get("")
@blueprint.output(AccountList)
def list_accounts() -> dict[str, Any]:
    """List all accounts."""
    with library().database.read() as session:
        return {"accounts": [told(person) for person in accounts.listed(session)]}


@blueprint.post("")
@blueprint.input(PersonIn, arg_name="wish")
@blueprint.output(SignInLinkOut, status_code=201)
def add(wish: dict[str, str]) -> dict[str, Any]:
    """Make an account, and a link to sign in to it."""
    with library().database.write() as session:
        return _link(session, accounts.create(session, wish["name"]))


@blueprint.post(f"/{_ID}/link")
@blueprint.output(SignInLinkOut, status_code=201)
def new_link(account_id: int) -> dict[str, Any]:
    """Make another link: for a person who cannot sign in any more."""
    with library().database.write() as session:
        return _link(session, _person(session, account_id))


@blueprint.delete(f"/{_ID}")
@blueprint.output({}, status_code=204)
def remove(account_id: int) -> str:
    """Delete an account; its maps stay."""
    with library().database.write() as session:
        accounts.remove(session, _person(session, account_id))
    return ""


def _person(session: Session, account_id: int) -> Account:
    found = session.get(Account, account_id)
    if found is None:
        raise NotFound("there is no such account")
    return found


def _link(session: Session, person: Account) -> dict[str, Any]:
    hours = settings().web.link_hours
    token = sign_in.new_link(session, person, hours=hours)
    url = url_for("sign_in.link", token=token, _external=True)
    return {"account": person.id, "url": url, "hours": hours}
