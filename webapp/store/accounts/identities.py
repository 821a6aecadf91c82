"""Identities of people at an OpenID Connect provider, and the roles that its groups give.

An identity is named by issuer and subject, as the specification demands: names and e-mail addresses change
hands. One without an account waits until an owner of the library links it.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ForeignKey, UniqueConstraint, delete, func, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from webapp.core import texts
from webapp.errors import Conflict, NotFound, UsageError
from webapp.store.accounts import accounts
from webapp.store.clock import now
from webapp.store.maps.maps import ROLES
from webapp.store.outbox import EventReceiver
from webapp.store.schema import IDS_USED_ONCE, WITHOUT_ROWID, Account, Base, MapRecord, Member

SIGN_IN, OWNER = "sign-in", "owner"
"""What a group gives for the whole library: leave to sign in, or ownership."""

_MOST_WAITING = 200
_MOST_RULES = 500
_MAX_TEXT = 255

_log = logging.getLogger(__name__)


class SignInIdentity(Base):
    """Somebody whom a provider has signed in."""

    __tablename__ = "sign_in_identity"
    __table_args__ = (UniqueConstraint("issuer", "subject"), IDS_USED_ONCE)

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)
    """None: it waits for an owner of the library."""
    issuer: Mapped[str]
    subject: Mapped[str]
    name: Mapped[str]
    """As the provider says, for people to read."""
    email: Mapped[str | None]
    gave_library: Mapped[bool] = mapped_column(default=False)
    """Whether a group made the account an owner of the library."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    seen_at: Mapped[datetime] = mapped_column(default=now)
    """Of its last sign-in."""


class GroupRole(Base):
    """What the members of a provider's group may do."""

    __tablename__ = "group_role"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    group: Mapped[str] = mapped_column("group_name")
    map_id: Mapped[int | None] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    """None: the whole library."""
    role: Mapped[str]
    """`owner`, `editor` or `viewer` of the map; `owner` or `sign-in` for the library."""


class GivenRole(Base):
    """A role on a map that an identity has by its groups, and loses with them."""

    __tablename__ = "given_role"
    __table_args__ = WITHOUT_ROWID

    identity_id: Mapped[int] = mapped_column(
        ForeignKey("sign_in_identity.id", ondelete="CASCADE"), primary_key=True
    )
    map_id: Mapped[int] = mapped_column(
        ForeignKey("map.id", ondelete="CASCADE"), primary_key=True, index=True
    )
    role: Mapped[str]
    before: Mapped[str | None]
    """The role that people had given; None if none."""


class ProviderSession(Base):
    """A session that began at a provider, with what ends the session there."""

    __tablename__ = "provider_session"
    __table_args__ = WITHOUT_ROWID

    id_hash: Mapped[str] = mapped_column(primary_key=True)
    """Of the session's id, as in `signed_in`."""
    identity_id: Mapped[int] = mapped_column(
        ForeignKey("sign_in_identity.id", ondelete="CASCADE"), index=True
    )
    id_token: Mapped[str]
    """Encrypted with a key derived from that of the library."""
    at: Mapped[datetime] = mapped_column(default=now)


@dataclass(frozen=True, slots=True)
class Person:
    """What a provider says about somebody, verified."""

    issuer: str
    subject: str
    name: str
    email: str | None
    email_verified: bool
    groups: tuple[str, ...]


def note(session: Session, person: Person) -> SignInIdentity:
    """Find the identity of a person, or keep a new one that waits for an account."""
    known = select(SignInIdentity).where(
        SignInIdentity.issuer == person.issuer, SignInIdentity.subject == person.subject
    )
    identity = session.scalar(known)
    if identity is None:
        _forget_oldest_waiting(session)
        identity = SignInIdentity(issuer=person.issuer, subject=person.subject)
        session.add(identity)
    identity.name, identity.email = person.name[:_MAX_TEXT], (person.email or "")[:_MAX_TEXT] or None
    identity.seen_at = now()
    session.flush()
    return identity


def link(session: Session, identity: SignInIdentity, *, account: Account) -> None:
    """Give an identity its account. Raises Conflict if it is that of another one."""
    if identity.account_id not in (None, account.id):
        raise Conflict(
            "this identity belongs to another account", hint="an owner of the library can unlink it there"
        )
    identity.account_id = account.id


def unlink(session: Session, identity: SignInIdentity) -> None:
    """Take an identity and the roles of its groups from its account."""
    if identity.account_id is not None:
        apply_groups(session, identity, groups=())
    session.delete(identity)


def new_account(session: Session, identity: SignInIdentity) -> Account:
    """Create the account of an identity, by its name, with a number if the name is taken."""
    tidy = texts.tidy_name(identity.name, most=50) or texts.tidy_name(identity.name[:40], most=50) or "Guest"
    for number in range(1, 1000):
        try:
            account = accounts.create(session, tidy if number == 1 else f"{tidy} {number}")
        except Conflict:
            continue
        link(session, identity, account=account)
        return account
    raise Conflict("this name is already taken", where=tidy, hint="choose another one")


def account_with_mail(session: Session, address: str, *, issuer: str) -> Account | None:
    """Find the account that has confirmed an e-mail address.

    Returns:
        None if there is none, or several, or if it has an identity there already: addresses change hands.
    """
    confirmed = (
        select(Account)
        .join(EventReceiver, EventReceiver.account_id == Account.id)
        .where(EventReceiver.kind == "mail", EventReceiver.confirmed_at.is_not(None))
        .where(func.lower(EventReceiver.address) == address.lower())
    )
    found = session.scalars(confirmed.distinct()).all()
    if len(found) != 1 or any(one.issuer == issuer for one in identities_of(session, found[0])):
        return None
    return found[0]


def identities_of(session: Session, account: Account) -> list[SignInIdentity]:
    """List the identities of an account, the oldest first."""
    mine = select(SignInIdentity).where(SignInIdentity.account_id == account.id)
    return list(session.scalars(mine.order_by(SignInIdentity.id)))


def everybody(session: Session) -> list[tuple[SignInIdentity, Account | None]]:
    """List all identities with their accounts, those that wait first, the last seen first."""
    found = select(SignInIdentity, Account).outerjoin(Account, Account.id == SignInIdentity.account_id)
    ordered = found.order_by(
        SignInIdentity.account_id.is_not(None), SignInIdentity.seen_at.desc(), SignInIdentity.id.desc()
    )
    return [(identity, account) for identity, account in session.execute(ordered)]


def find(session: Session, id: int) -> SignInIdentity:
    """Find an identity. Raises NotFound."""
    identity = session.get(SignInIdentity, id)
    if identity is None:
        raise NotFound("identity not found", hint="reload the page")
    return identity


def add_rule(session: Session, group: str, *, role: str, map_id: int | None) -> None:
    """Add a line to the table of groups.

    Raises:
        UsageError: A name or the role is not valid, or there are too many lines.
        Conflict: The group has a line for the map, or for the library, already.
    """
    group = group.strip()
    allowed = (SIGN_IN, OWNER) if map_id is None else ROLES
    if not 0 < len(group) <= _MAX_TEXT or not group.isprintable():
        raise UsageError("this is not the name of a group", hint="write it as the provider sends it")
    if role not in allowed:
        raise UsageError("unknown role", where=role[:20], hint=f"it is one of {', '.join(allowed)}")
    if map_id is not None and session.get(MapRecord, map_id) is None:
        raise NotFound("map not found", hint="reload the page")
    there = rules(session)
    if len(there) >= _MOST_RULES:
        raise UsageError(f"the table has at most {_MOST_RULES} lines", hint="remove one first")
    if any((one.group, one.map_id) == (group, map_id) for one, _ in there):
        raise Conflict("this group has a role there already", hint="remove that line first")
    session.add(GroupRole(group=group, role=role, map_id=map_id))


def remove_rule(session: Session, id: int) -> None:
    """Remove a line; whoever has the role by it loses it at the next sign-in. Raises NotFound."""
    rule = session.get(GroupRole, id)
    if rule is None:
        raise NotFound("this line is gone already", hint="reload the page")
    session.delete(rule)


def rules(session: Session) -> list[tuple[GroupRole, MapRecord | None]]:
    """List the table of groups with the maps, by group."""
    found = select(GroupRole, MapRecord).outerjoin(MapRecord, MapRecord.id == GroupRole.map_id)
    ordered = found.order_by(GroupRole.group, GroupRole.map_id.is_not(None), MapRecord.name, GroupRole.id)
    return [(rule, record) for rule, record in session.execute(ordered)]


def has_rule(session: Session, groups: Collection[str]) -> bool:
    """Return whether one of the groups is in the table."""
    return any(rule.group in groups for rule, _ in rules(session))


def apply_groups(session: Session, identity: SignInIdentity, *, groups: Collection[str]) -> None:
    """Give the account of an identity the roles of its groups, and take back those of groups it has left.

    Roles that people gave are kept, also where they are higher.
    """
    account = session.get_one(Account, identity.account_id)
    mine = [rule for rule, _ in rules(session) if rule.group in groups]
    _apply_library(session, identity, owns=any((r.map_id, r.role) == (None, OWNER) for r in mine))
    wanted: dict[int, str] = {}
    for rule in mine:
        if rule.map_id is not None:
            wanted[rule.map_id] = _higher(rule.role, wanted.get(rule.map_id)) or rule.role
    given = select(GivenRole.map_id).where(GivenRole.identity_id == identity.id)
    for map_id in sorted({*wanted, *session.scalars(given)}):
        try:
            _apply_map(session, identity, map_id=map_id, wanted=wanted.get(map_id))
        except UsageError as error:  # the last owner of a map stays, whatever the groups say
            _log.warning("a role of %s on map %s is kept: %s", account.name, map_id, error.message)


def begin_session(
    session: Session, identity: SignInIdentity, *, id_hash: str, id_token: str, days: int
) -> None:
    """Keep what ends a session at the provider, and forget sessions that are over."""
    session.execute(delete(ProviderSession).where(ProviderSession.at < now() - timedelta(days=days)))
    session.merge(ProviderSession(id_hash=id_hash, identity_id=identity.id, id_token=id_token))


def end_session(session: Session, id_hash: str) -> str | None:
    """Forget a session; returns its encrypted ID token."""
    row = session.get(ProviderSession, id_hash)
    if row is None:
        return None
    session.delete(row)
    return row.id_token


def _forget_oldest_waiting(session: Session) -> None:
    waiting = (
        select(SignInIdentity.id)
        .where(SignInIdentity.account_id.is_(None))
        .order_by(SignInIdentity.seen_at.desc())
    )
    old = session.scalars(waiting.offset(_MOST_WAITING - 1)).all()
    session.execute(delete(SignInIdentity).where(SignInIdentity.id.in_(old)))


def _apply_library(session: Session, identity: SignInIdentity, *, owns: bool) -> None:
    account = session.get_one(Account, identity.account_id)
    if owns and not account.is_owner:
        account.is_owner = identity.gave_library = True
    elif not owns and identity.gave_library:
        identity.gave_library = False
        others = select(Account.id).where(Account.is_owner, Account.id != account.id)
        account.is_owner = session.scalar(others.limit(1)) is None
        if account.is_owner:
            _log.warning("%s has left the group of owners, but a library needs an owner", account.name)


def _apply_map(session: Session, identity: SignInIdentity, *, map_id: int, wanted: str | None) -> None:
    """Bring the role on one map up to date: the higher one of what people and what groups gave."""
    record, account = session.get_one(MapRecord, map_id), session.get_one(Account, identity.account_id)
    member, given = session.get(Member, (map_id, account.id)), session.get(GivenRole, (identity.id, map_id))
    has = None if member is None else member.role
    before = given.before if given is not None and has == given.role else has
    role = _higher(wanted, before)
    if role is None:
        accounts.remove_member(session, record, account=account)
    elif role != has:
        accounts.set_member_role(session, record, account=account, role=role)
    if role != before:
        session.merge(GivenRole(identity_id=identity.id, map_id=map_id, role=role, before=before))
    elif given is not None:
        session.delete(given)
    session.flush()


def _higher(role: str | None, other: str | None) -> str | None:
    return max(role, other, key=(None, *ROLES).index)
