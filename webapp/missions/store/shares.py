"""Views of missions that are open without a sign-in: to whoever has a link, or to everybody."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.missions.store.schema import Mission, MissionShare
from webapp.store.accounts.accounts import hashed


@dataclass(frozen=True, slots=True)
class OpenedMission:
    """What a visitor sees; records of a session that is closed.

    Attributes
    ----------
    share : MissionShare
    mission : Mission
    """

    share: MissionShare
    mission: Mission


def create(
    session: Session, mission: Mission, *, photos: bool, account_id: int, public: bool = False
) -> tuple[MissionShare, str]:
    """Share a mission.

    Parameters
    ----------
    session : Session
        That writes.
    mission : Mission
    photos : bool
        Whether photos are shown.
    account_id : int
        Who shares it.
    public : bool
        Whether it is listed for everybody.

    Returns
    -------
    MissionShare
    str
        End of its address. Of a secret one it is kept nowhere, only its hash.
    """
    token = secrets.token_urlsafe(24)
    share = MissionShare(
        mission_id=mission.id,
        token_hash=hashed(token),
        public_token=token if public else None,
        account_id=account_id,
        photos=photos,
    )
    session.add(share)
    session.flush()
    return share, token


def listed(session: Session, mission: Mission) -> list[MissionShare]:
    """List the shares of a mission, the newest first."""
    found = select(MissionShare).where(MissionShare.mission_id == mission.id)
    return list(session.scalars(found.order_by(MissionShare.id.desc())))


def find(session: Session, mission: Mission, *, id: int) -> MissionShare:
    """Find a share of a mission.

    Raises
    ------
    NotFound
    """
    share = session.get(MissionShare, id)
    if share is None or share.mission_id != mission.id:
        raise NotFound("the mission has no such link", hint="it may have been taken back: reload the page")
    return share


def opened(session: Session, token: str) -> OpenedMission:
    """Tell what the end of an address opens.

    Raises
    ------
    NotFound
        Nothing: it was never one, it was taken back, or the mission is in the bin. Visitors are not told
        which.
    """
    found = select(MissionShare).where(MissionShare.token_hash == hashed(token))
    share = session.scalars(found).first()
    mission = None if share is None else session.get_one(Mission, share.mission_id)
    if share is None or mission is None or mission.binned_at is not None:
        raise NotFound(
            "this link is not valid, or no longer valid", hint="ask the person who sent it for a new one"
        )
    return OpenedMission(share, mission)


def public(session: Session) -> list[OpenedMission]:
    """List what is open to everybody, the newest first."""
    found = (
        select(MissionShare, Mission)
        .join(Mission, Mission.id == MissionShare.mission_id)
        .where(MissionShare.public_token.is_not(None), Mission.binned_at.is_(None))
        .order_by(MissionShare.id.desc())
    )
    return [OpenedMission(*row) for row in session.execute(found)]
