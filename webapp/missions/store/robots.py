"""Robots of a mission: what they said of themselves, when they were last heard, and when they were silent."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.missions.core.trajectory.batch import Status
from webapp.missions.store.schema import Mission, RobotHeard, RobotReport, RobotSilence

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
        known.time_s = max(known.time_s, at_s)


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
