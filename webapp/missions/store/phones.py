"""Links by which phones send their positions to a mission, without an account."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from webapp.core import texts
from webapp.errors import Conflict, NotFound, UsageError
from webapp.missions.store.schema import Mission, MissionPhone
from webapp.store.accounts.accounts import hashed
from webapp.store.clock import now
from webapp.store.sharing import link_not_valid

_MAX_NAME = 60
_MOST_PHONES = 200
MOST_POSITIONS = 500_000
"""Of one link, so that one that got into wrong hands cannot fill the disk: six days of one each second."""


@dataclass(frozen=True, slots=True)
class OpenedPhone:
    """A phone and its mission; the records outlive their session."""

    phone: MissionPhone
    mission: Mission


def create(session: Session, mission: Mission, *, name: str, account_id: int) -> tuple[MissionPhone, str]:
    """Make a link for a phone; return it, and its token, of which only a hash is stored.

    Raises:
        UsageError: The name is not valid.
        Conflict: Another phone of the mission has it, or there are too many.
    """
    tidy = texts.tidy_name(name, most=_MAX_NAME)
    if tidy is None:
        hint = f"give 1 to {_MAX_NAME} printable characters"
        raise UsageError("this is not a valid name for a phone", where="name", hint=hint)
    others = list_phones(session, mission)
    if any(texts.plain(other.name) == texts.plain(tidy) for other in others):
        raise Conflict(f"this mission already has a phone {tidy!r}", where="name", hint="give another name")
    if len(others) >= _MOST_PHONES:
        raise Conflict(
            f"this mission already has {_MOST_PHONES} phones", hint="remove those that send nothing"
        )
    token = secrets.token_urlsafe(24)
    phone = MissionPhone(mission_id=mission.id, name=tidy, token_hash=hashed(token), account_id=account_id)
    session.add(phone)
    session.flush()
    return phone, token


def list_phones(session: Session, mission: Mission) -> list[MissionPhone]:
    found = select(MissionPhone).where(MissionPhone.mission_id == mission.id)
    return list(session.scalars(found.order_by(MissionPhone.name)))


def remove(session: Session, mission: Mission, *, id: int) -> None:
    """Remove a phone: its link stops working, its track stays. Raises NotFound."""
    phone = session.get(MissionPhone, id)
    if phone is None or phone.mission_id != mission.id:
        raise NotFound("phone not found", hint="it may have been removed: reload the page")
    session.delete(phone)


def open_phone(session: Session, token: str) -> OpenedPhone:
    """Find the phone of a link.

    Raises:
        NotFound: The token is not valid, or the mission is in the bin.
    """
    phone = session.scalars(select(MissionPhone).where(MissionPhone.token_hash == hashed(token))).first()
    mission = None if phone is None else session.get_one(Mission, phone.mission_id)
    if phone is None or mission is None or mission.binned_at is not None:
        raise link_not_valid()
    return OpenedPhone(phone, mission)


def note_positions(session: Session, phone: MissionPhone, *, count: int) -> None:
    """Count positions of a phone, in the transaction that stores them.

    Raises:
        Conflict: They are more than a link may send.
    """
    changed = session.execute(
        update(MissionPhone)
        .where(MissionPhone.id == phone.id, MissionPhone.positions <= MOST_POSITIONS - count)
        .values(positions=MissionPhone.positions + count, heard_at=now())
    )
    if not changed.rowcount:  # type: ignore[attr-defined]
        raise Conflict("this link has sent too many positions", hint="ask for a new link")
