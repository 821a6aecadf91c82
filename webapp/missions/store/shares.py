"""Views of missions that need no sign-in: for holders of a link, or public."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionShare
from webapp.store import outbox, sharing


@dataclass(frozen=True, slots=True)
class OpenedMission:
    """The share that a visitor opened, and its mission; the records outlive their session."""

    share: MissionShare
    mission: Mission


def create(
    session: Session, mission: Mission, *, photos: bool, account_id: int, public: bool = False
) -> tuple[MissionShare, str]:
    """Share a mission, with or without photos; return the share, and the token from `open_link`."""
    share = MissionShare(mission_id=mission.id, account_id=account_id, photos=photos)
    token = sharing.open_link(session, share, public=public)
    by = sharing.creator_of(session, share)
    outbox.emit(
        session,
        outbox.SHARE_MADE,
        facts={"mission": {"id": mission.id, "name": mission.name}, "public": public, "by": by},
        concerns=lambda account: missions.role_of(session, mission, account=account) == "owner",
    )
    return share, token


def list_shares(session: Session, mission: Mission) -> list[MissionShare]:
    """List the shares of a mission, newest first."""
    return sharing.shares_of(session, MissionShare, where=MissionShare.mission_id == mission.id)


def find(session: Session, mission: Mission, *, id: int) -> MissionShare:
    """Find a share of a mission. Raises NotFound."""
    return sharing.find_share(session, MissionShare, id=id, where=MissionShare.mission_id == mission.id)


def open_share(session: Session, token: str) -> OpenedMission:
    """Find the share with the token of a link.

    Raises:
        NotFound: The token is not valid, or the mission is in the bin.
    """
    share = sharing.share_by_token(session, MissionShare, token=token)
    mission = None if share is None else session.get_one(Mission, share.mission_id)
    if share is None or mission is None or mission.binned_at is not None:
        raise sharing.link_not_valid()
    return OpenedMission(share, mission)


def public(session: Session) -> list[OpenedMission]:
    """List the public shares, newest first."""
    found = (
        select(MissionShare, Mission)
        .join(Mission, Mission.id == MissionShare.mission_id)
        .where(MissionShare.public_token.is_not(None), Mission.binned_at.is_(None))
        .order_by(MissionShare.id.desc())
    )
    return [OpenedMission(*row) for row in session.execute(found)]
