"""With whom a map is shared."""

from __future__ import annotations

from typing import cast

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import UsageError
from webapp.store.maps.maps import ROLES, Role
from webapp.store.schema import Account, MapRecord, Member


def listed(session: Session, record: MapRecord) -> list[tuple[Account, Role]]:
    """List who may use a map, by name, with the role of each."""
    found = select(Account, Member).join(Member).where(Member.map_id == record.id).order_by(Account.name)
    return [(account, _role(member)) for account, member in session.execute(found)]


def set_role(session: Session, record: MapRecord, *, account: Account, role: str) -> None:
    """Share a map with an account, or change what it may do.

    Raises
    ------
    UsageError
        There is no such role, or the map would have no owner.
    """
    if role not in ROLES:
        raise UsageError("there is no such role", where=role[:20], hint=f"it is one of {', '.join(ROLES)}")
    member = session.get(Member, (record.id, account.id))
    if member is None:
        session.add(Member(map_id=record.id, account_id=account.id, role=role))
        return
    if role != "owner":
        _keep_an_owner(session, member)
    member.role = role


def remove(session: Session, record: MapRecord, *, account: Account) -> None:
    """Share a map no longer with an account; somebody it was not shared with is no error.

    Raises
    ------
    UsageError
        The map would have no owner.
    """
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
