"""API of accounts: the caller's own with its tokens, and all accounts for the owner of the library.

Passwords and sessions are managed on the pages only.
"""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Integer, List, Nested, String
from apiflask.validators import OneOf
from flask import url_for
from flask_wtf.csrf import generate_csrf
from sqlalchemy.orm import Session

from webapp.errors import NotAllowed, NotFound
from webapp.store import sharing
from webapp.store.accounts import accounts, sign_in
from webapp.store.schema import Account, ApiToken
from webapp.web.accounts import ways
from webapp.web.context import account, library, settings
from webapp.web.fields import LATER
from webapp.web.language import LANGUAGES

account_api = APIBlueprint("api_account", __name__, url_prefix="/api/v1/account", tag="Accounts")

session_api = APIBlueprint("api_session", __name__, url_prefix="/api/v1/session", tag="Session")

people_api = APIBlueprint("api_people", __name__, url_prefix="/api/v1/accounts", tag="Accounts")
_ID = "<id:account_id>"


class AccountOut(Schema):
    """An account."""

    id = Integer()
    name = String()
    is_owner = Boolean(metadata={"description": "Whether the account is an owner of the library."})
    language = String(allow_none=True, metadata={"description": "Of the pages; null for the browser's."})
    has_password = Boolean()
    created_at = String()


class AccountIn(Schema):
    """Fields to change; omitted ones are kept."""

    name = String(validate=LATER)
    language = String(allow_none=True, validate=OneOf(LANGUAGES))


class TokenIn(Schema):
    """A token to make."""

    name = String(
        required=True, validate=LATER, metadata={"description": "Of the program that is going to use it."}
    )


class TokenOut(Schema):
    """A token, without its secret."""

    id = Integer()
    name = String()
    created_at = String()
    used_at = String(allow_none=True, metadata={"description": "To the hour."})


class NewToken(TokenOut):
    """A new token, with its secret."""

    token = String(metadata={"description": "The secret: it is in this answer and nowhere else."})


class TokenList(Schema):
    """Tokens, the oldest first."""

    tokens = List(Nested(TokenOut))


@account_api.get("")
@account_api.output(AccountOut)
def show() -> dict[str, Any]:
    """Get the caller's account."""
    return account_json(account())


@account_api.patch("")
@account_api.input(AccountIn, arg_name="data")
@account_api.output(AccountOut)
def change(data: dict[str, str | None]) -> dict[str, Any]:
    """Change the caller's name or language."""
    with library().database.write() as session:
        me = session.get_one(Account, account().id)
        if (name := data.get("name")) is not None:
            accounts.rename(session, me, name=name)
        me.language = data.get("language", me.language)
    return account_json(me)


@account_api.get("/tokens")
@account_api.output(TokenList)
def list_tokens() -> dict[str, Any]:
    """List the caller's tokens."""
    with library().database.read() as session:
        return {"tokens": [_token(token) for token in accounts.tokens(session, account())]}


@account_api.post("/tokens")
@account_api.input(TokenIn, arg_name="data")
@account_api.output(NewToken, status_code=201)
def new_token(data: dict[str, str]) -> dict[str, Any]:
    """Make a token."""
    with library().database.write() as session:
        secret = accounts.new_token(session, account(), name=data["name"])
        made = accounts.tokens(session, account())[-1]
    return {**_token(made), "token": secret}


@account_api.delete("/tokens/<id:token_id>")
@account_api.output({}, status_code=204)
def revoke_token(token_id: int) -> str:
    """Revoke a token."""
    with library().database.write() as session:
        accounts.revoke_token(session, account(), token_id=token_id)
    return ""


def account_json(who: Account) -> dict[str, Any]:
    return {
        "id": who.id,
        "name": who.name,
        "is_owner": who.is_owner,
        "language": who.language,
        "has_password": who.password_hash is not None,
        "created_at": who.created_at.isoformat(timespec="seconds"),
    }


def _token(token: ApiToken) -> dict[str, Any]:
    return {
        "id": token.id,
        "name": token.name,
        "created_at": token.created_at.isoformat(timespec="seconds"),
        "used_at": None if token.used_at is None else token.used_at.isoformat(timespec="seconds"),
    }


class SessionOut(Schema):
    """The caller."""

    account = Integer(metadata={"description": "Id."})
    name = String()
    csrf = String(metadata={"description": "Pages send it as `X-CSRFToken` with all that changes something."})


@session_api.get("", endpoint="show")
@session_api.output(SessionOut)
def show_session() -> dict[str, Any]:
    """Get the caller's account, and the CSRF token that pages send with their requests."""
    who = account()
    return {"account": who.id, "name": who.name, "csrf": generate_csrf()}


class PersonIn(Schema):
    """An account to make."""

    name = String(required=True, validate=LATER)


class SignInLinkOut(Schema):
    """A one-time sign-in link."""

    account = Integer(metadata={"description": "Id."})
    url = String(metadata={"description": "It is in this answer and nowhere else."})
    hours = Integer(metadata={"description": "How long it works."})


class RevokedOut(Schema):
    """Result of a revocation."""

    revoked = Integer(metadata={"description": "Number of links."})


class AccountList(Schema):
    """All accounts, by name."""

    accounts = List(Nested(AccountOut))


@people_api.before_request
def only_owners() -> None:
    """Allow only owners of the library."""
    if not account().is_owner:
        raise NotAllowed("only the owner of the library may do this")


@people_api.get("")
@people_api.output(AccountList)
def list_accounts() -> dict[str, Any]:
    """List all accounts."""
    with library().database.read() as session:
        return {"accounts": [account_json(person) for person in accounts.list_accounts(session)]}


@people_api.post("")
@people_api.input(PersonIn, arg_name="data")
@people_api.output(SignInLinkOut, status_code=201)
def add(data: dict[str, str]) -> dict[str, Any]:
    """Make an account, and a link to sign in to it."""
    ways.check_new_links()
    with library().database.write() as session:
        return _link(session, accounts.create(session, data["name"]))


@people_api.post(f"/{_ID}/link")
@people_api.output(SignInLinkOut, status_code=201)
def new_link(account_id: int) -> dict[str, Any]:
    """Make another sign-in link, for a user who can no longer sign in."""
    ways.check_new_links()
    with library().database.write() as session:
        return _link(session, _person(session, account_id))


@people_api.delete(f"/{_ID}")
@people_api.output({}, status_code=204)
def remove(account_id: int) -> str:
    """Delete an account; its maps stay, and so do the links that it made."""
    with library().database.write() as session:
        accounts.remove(session, _person(session, account_id))
    return ""


@people_api.delete("/removed/shares")
@people_api.output(RevokedOut)
def revoke_shares_of_removed() -> dict[str, int]:
    """Revoke all links to maps, answers and missions that were made by accounts since deleted."""
    with library().database.write() as session:
        return {"revoked": sharing.revoke_of_removed_accounts(session)}


def _person(session: Session, account_id: int) -> Account:
    found = session.get(Account, account_id)
    if found is None:
        raise NotFound("account not found")
    return found


def _link(session: Session, person: Account) -> dict[str, Any]:
    hours = settings().web.link_hours
    token = sign_in.new_link(session, person, hours=hours)
    url = url_for("sign_in.link", token=token, _external=True)
    return {"account": person.id, "url": url, "hours": hours}
