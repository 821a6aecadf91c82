"""Robots of a mission: what they said of themselves, when they were last heard, and when they were silent."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sqlalchemy import Select, or_, select
from sqlalchemy.orm import Session

from webapp.missions.core.trajectory.batch import Status
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, RobotHeard, RobotReport, RobotSilence
from webapp.store import outbox

MOST_SILENCES = 200
"""Maximum number of silences in one response."""

LEAST_SILENT_S, MOST_SILENT_S = 5.0, 86_400.0
"""Limits of the time after which a robot counts as silent."""


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot or person that has sent batches; its name is that of its tracks, perhaps empty."""

    name: str
    heard_time_s: float  # When the server last had a record of it, Unix seconds
    status: RobotReport | None  # The latest by its own clock


def hear(session: Session, mission: Mission, *, names: Iterable[str], at_s: float) -> None:
    """Note that robots were heard; one that was silent for too long until then gets an entry in the log."""
    for name in sorted(set(names)):
        known = session.get(RobotHeard, (mission.id, name))
        if known is None:
            session.add(RobotHeard(mission_id=mission.id, robot=name, time_s=at_s))
            continue
        if mission.silent_after_s is not None and at_s - known.time_s > mission.silent_after_s:
            since = RobotSilence(mission_id=mission.id, robot=name, since_s=known.time_s, until_s=at_s)
            session.add(since)
            _emit(session, mission, outbox.ROBOT_HEARD, heard=known, until_s=at_s)
        known.time_s = max(known.time_s, at_s)


def note_silences(session: Session, *, at_s: float) -> int:
    """Note which robots have become silent, each once, as an event; return their number."""
    # another worker may be noting the same: what it has locked is left to it
    late = list(session.execute(_late(at_s).with_for_update(of=RobotHeard, skip_locked=True)))
    for heard, mission in late:
        heard.silence_noted_s = heard.time_s
        _emit(session, mission, outbox.ROBOT_SILENT, heard=heard)
    return len(late)


def any_late(session: Session, *, at_s: float) -> bool:
    """Return whether `note_silences` has something to note."""
    return session.execute(_late(at_s).limit(1)).first() is not None


def _late(at_s: float) -> Select[RobotHeard, Mission]:
    """Select the robots of running missions that are silent for too long, which is not noted yet."""
    noted = RobotHeard.silence_noted_s
    return (
        select(RobotHeard, Mission)
        .join(Mission, Mission.id == RobotHeard.mission_id)
        .where(
            Mission.silent_after_s.is_not(None),
            Mission.ended_at.is_(None),
            Mission.binned_at.is_(None),
            RobotHeard.time_s + Mission.silent_after_s < at_s,
            or_(noted.is_(None), noted < RobotHeard.time_s),
        )
    )


def _emit(
    session: Session, mission: Mission, event: str, *, heard: RobotHeard, until_s: float | None = None
) -> None:
    facts = {
        "mission": {"id": mission.id, "name": mission.name},
        "robot": heard.robot,
        "silent_since_s": heard.time_s,
        **({} if until_s is None else {"heard_s": until_s}),
    }
    outbox.emit(
        session,
        event,
        facts=facts,
        concerns=lambda account: missions.role_of(session, mission, account=account) is not None,
    )


def add_statuses(session: Session, mission_id: int, *, found: Sequence[Status]) -> None:
    """Store what robots said of themselves."""
    session.add_all(
        RobotReport(
            mission_id=mission_id,
            robot=one.robot,
            time_s=one.time_s,
            battery_percent=one.battery_percent,
            link_percent=one.link_percent,
            mode=one.mode,
            text=one.text,
        )
        for one in found
    )


def list_robots(session: Session, mission_id: int) -> list[Robot]:
    heard = select(RobotHeard).where(RobotHeard.mission_id == mission_id).order_by(RobotHeard.robot)
    return [
        Robot(row.robot, row.time_s, _latest(session, mission_id, row.robot))
        for row in session.scalars(heard)
    ]


def list_silences(session: Session, mission_id: int) -> list[RobotSilence]:
    """List the silences that are over, the latest first."""
    mine = select(RobotSilence).where(RobotSilence.mission_id == mission_id)
    return list(session.scalars(mine.order_by(RobotSilence.id.desc()).limit(MOST_SILENCES)))


def _latest(session: Session, mission_id: int, name: str) -> RobotReport | None:
    mine = (RobotReport.mission_id == mission_id, RobotReport.robot == name)
    latest = select(RobotReport).where(*mine).order_by(RobotReport.time_s.desc(), RobotReport.id.desc())
    return session.scalars(latest.limit(1)).first()
