"""Accounts, their API tokens, and the members of maps."""

from __future__ import annotations

import hashlib
import secrets
from typing import cast

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.core import texts
from webapp.errors import Conflict, NotFound, UsageError
from webapp.store import outbox
from webapp.store.clock import now
from webapp.store.maps.maps import ROLES, Role
from webapp.store.schema import Account, ApiToken, MapRecord, Member

OWNER = "owner"
"""Name of the first account of a new library."""

_MAX_NAME = 60
_TOKEN_PREFIX = "expmap_"  # so that scanners for leaked secrets recognise it


def ensure_owner(session: Session) -> Account:
    """Return the first account that owns the library; create it for a new library."""
    found = session.scalars(select(Account).where(Account.is_owner).order_by(Account.id)).first()
    return found or create(session, OWNER, is_owner=True)


def create(session: Session, name: str, *, is_owner: bool = False) -> Account:
    """Create an account; signing in requires a link or a password, which it does not have yet."""
    account = Account(name=_free_name(session, name), is_owner=is_owner)
    session.add(account)
    session.flush()
    return account


def rename(session: Session, account: Account, *, name: str) -> None:
    account.name = _free_name(session, name, own=account.id)


def named(session: Session, name: str) -> Account:
    """Find an account by its name, ignoring case. Raises NotFound."""
    found = _named(session, name)
    if found is None:
        raise NotFound(
            "no account has this name",
            where=name[:_MAX_NAME],
            hint="the owner of the library creates accounts",
        )
    return found


def list_accounts(session: Session) -> list[Account]:
    """List all accounts, sorted by name."""
    return list(session.scalars(select(Account).order_by(Account.name)))


def remove(session: Session, account: Account) -> None:
    """Delete an account; its maps are kept, and accessible to the owners of the library.

    Raises:
        UsageError: It is the last account that owns the library.
    """
    owners = session.scalars(select(func.count()).select_from(Account).where(Account.is_owner)).one()
    if account.is_owner and owners == 1:
        raise UsageError("a library needs an owner", hint="make another account the owner first")
    session.delete(account)


def end_sessions(account: Account) -> None:
    """Sign an account out everywhere; tokens stay valid."""
    account.epoch += 1


def new_token(session: Session, account: Account, *, name: str) -> str:
    """Create an API token; only its hash is stored."""
    name = _checked_name(name)
    if any(token.name == name for token in tokens(session, account)):
        raise Conflict(
            "a token with this name already exists",
            where=name,
            hint="choose another name, or revoke it on the account page",
        )
    token = _TOKEN_PREFIX + secrets.token_urlsafe(32)
    session.add(ApiToken(account_id=account.id, name=name, token_hash=hashed(token)))
    return token


def tokens(session: Session, account: Account) -> list[ApiToken]:
    """List the tokens of an account, the oldest first."""
    found = select(ApiToken).where(ApiToken.account_id == account.id)
    return list(session.scalars(found.order_by(ApiToken.id)))


def by_token(session: Session, token: str) -> tuple[Account, ApiToken] | None:
    """Return the account and the record of a token; None if it is unknown."""
    found = select(Account, ApiToken).join(ApiToken).where(ApiToken.token_hash == hashed(token))
    row = session.execute(found).first()
    return None if row is None else (row[0], row[1])


def record_use(session: Session, token_id: int) -> None:
    token = session.get(ApiToken, token_id, with_for_update=True)
    if token is not None:
        token.used_at = now()


def revoke_token(session: Session, account: Account, *, token_id: int) -> None:
    token = session.get(ApiToken, token_id)
    if token is None or token.account_id != account.id:
        raise NotFound("token not found", hint="reload the page")
    session.delete(token)


def hashed(secret: str) -> str:
    """Hash a random secret, which cannot be guessed, so that a plain hash is enough."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _named(session: Session, name: str) -> Account | None:
    wanted = texts.plain(name)
    there = session.scalars(select(Account).order_by(Account.id))
    alike = [account for account in there if texts.plain(account.name) == wanted]
    # Older versions distinguished names that are equivalent now: an exact match takes precedence.
    return next((account for account in alike if account.name == name), alike[0] if alike else None)


def _free_name(session: Session, name: str, *, own: int | None = None) -> str:
    tidy = _checked_name(name)
    look = texts.looks(tidy)
    if any(account.id != own and texts.looks(account.name) == look for account in list_accounts(session)):
        raise Conflict("this name is already taken", where=tidy, hint="choose another one")
    return tidy


def _checked_name(name: str) -> str:
    tidy = texts.tidy_name(name, most=_MAX_NAME)
    if tidy is None:
        raise UsageError("this is not a valid name", hint=f"give 1 to {_MAX_NAME} printable characters")
    return tidy


def members_of(session: Session, record: MapRecord) -> list[tuple[Account, Role]]:
    """List the members of a map, sorted by name, with their roles."""
    found = select(Account, Member).join(Member).where(Member.map_id == record.id).order_by(Account.name)
    return [(account, _role(member)) for account, member in session.execute(found)]


def set_member_role(session: Session, record: MapRecord, *, account: Account, role: str) -> None:
    """Share a map with an account, or change its role.

    Raises:
        UsageError: The role is unknown, or the map would have no owner.
    """
    if role not in ROLES:
        raise UsageError("unknown role", where=role[:20], hint=f"it is one of {', '.join(ROLES)}")
    member = session.get(Member, (record.id, account.id))
    if member is None:
        session.add(Member(map_id=record.id, account_id=account.id, role=role))
        outbox.emit(
            session,
            outbox.SHARE_INVITED,
            facts={"map": outbox.about_map(record), "role": role},
            concerns=lambda other: other.id == account.id,
        )
        return
    if role != "owner":
        _keep_an_owner(session, member)
    member.role = role


def remove_member(session: Session, record: MapRecord, *, account: Account) -> None:
    """Stop sharing a map with an account; no error if it was not shared with it."""
    member = session.get(Member, (record.id, account.id))
    if member is not None:
        _keep_an_owner(session, member)
        session.delete(member)


def _keep_an_owner(session: Session, member: Member) -> None:
    owners = select(Member.account_id).where(Member.map_id == member.map_id, Member.role == "owner")
    if list(session.scalars(owners)) == [member.account_id]:
        raise UsageError("a map needs an owner", hint="make somebody else the owner first")


def _role(member: Member) -> Role:
    return cast(Role, member.role)
