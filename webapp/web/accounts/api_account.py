"""One's own account and the tokens of one's programs. Passwords and sessions are left to the pages."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Integer, List, Nested, String
from apiflask.validators import OneOf

from webapp.store.accounts import accounts
from webapp.store.schema import Account, ApiToken
from webapp.web.context import account, library
from webapp.web.language import LANGUAGES

blueprint = APIBlueprint("api_account", __name__, url_prefix="/api/v1/account", tag="Accounts")


class AccountOut(Schema):
    """An account."""

    id = Integer()
    name = String()
    is_owner = Boolean(metadata={"description": "Of the whole library."})
    language = String(allow_none=True, metadata={"description": "Of the pages; null for the browser's."})
    has_password = Boolean()
    created_at = String()


class AccountIn(Schema):
    """What is to be another; what is left out stays."""

    name = String()
    language = String(allow_none=True, validate=OneOf(LANGUAGES))


class TokenIn(Schema):
    """A token to make."""

    name = String(required=True, metadata={"description": "Of the program that is going to use it."})


class TokenOut(Schema):
    """A token, without its secret."""

    id = Integer()
    name = String()
    created_at = String()
    used_at = String(allow_none=True, metadata={"description": "To the hour."})


class NewToken(TokenOut):
    """A token as it is made."""

    token = String(metadata={"description": "The secret: it is in this answer and nowhere else."})


class TokenList(Schema):
    """Tokens, the oldest first."""

    tokens = List(Nested(TokenOut))


@blueprint.get("")
@blueprint.output(AccountOut)
def show() -> dict[str, Any]:
    """Tell who asks."""
    return told(account())


@blueprint.patch("")
@blueprint.input(AccountIn, arg_name="wish")
@blueprint.output(AccountOut)
def change(wish: dict[str, str | None]) -> dict[str, Any]:
    """Take another name or language."""
    with library().database.write() as session:
        me = session.get_one(Account, account().id)
        if (name := wish.get("name")) is not None:
            accounts.rename(session, me, name=name)
        me.language = wish.get("language", me.language)
    return told(me)


@blueprint.get("/tokens")
@blueprint.output(TokenList)
def list_tokens() -> dict[str, Any]:
    """List one's tokens."""
    with library().database.read() as session:
        return {"tokens": [_token(token) for token in accounts.tokens(session, account())]}


@blueprint.post("/tokens")
@blueprint.input(TokenIn, arg_name="wish")
@blueprint.output(NewToken, status_code=201)
def new_token(wish: dict[str, str]) -> dict[str, Any]:
    """Make a token."""
    with library().database.write() as session:
        secret = accounts.new_token(session, account(), name=wish["name"])
        made = accounts.tokens(session, account())[-1]
    return {**_token(made), "token": secret}


@blueprint.delete("/tokens/<int(max=2147483647):token_id>")
@blueprint.output({}, status_code=204)
def revoke_token(token_id: int) -> str:
    """Make a token worthless."""
    with library().database.write() as session:
        accounts.revoke_token(session, account(), token_id=token_id)
    return ""


def told(who: Account) -> dict[str, Any]:
    """Tell about an account what its owner may know."""
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
