"""Gathers what the report of a mission says; its size is limited, however long the mission was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from typing import Literal

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.missions.core.trajectory.outgoing import ExportObject, MissionExport
from webapp.missions.store import drawings, missions, phones, reading, robots, tracks, way
from webapp.missions.store.robots import Robot
from webapp.missions.store.schema import Mission, ObjectChange, RobotSilence
from webapp.missions.store.way import Way
from webapp.missions.tasks.coverage import AreaSearch, search_areas
from webapp.store.library import Library
from webapp.store.schema import Account, MapRecord

MAX_OBJECTS = 1000
"""Objects that are listed."""

MAX_CHANGES = 1000
"""Changes of the states of objects that are listed."""

MAX_POSES = 2000
"""Poses of each track on the map, evenly spread."""

_COVERAGE_S = 20.0
"""Time for computing what was covered."""

Deed = Literal["made", "drew", "searched", "set", "phone"]
"""What somebody did: made the mission, drew, marked areas as searched, set states, sent from a phone."""


@dataclass(frozen=True, slots=True)
class People:
    """What concerns people, which visitors do not get."""

    note: str
    robots: tuple[Robot, ...]
    silences: tuple[RobotSilence, ...]  # Oldest first
    silent_after_s: float | None
    changes: tuple[ObjectChange, ...]  # Oldest first
    deeds: Mapping[str, Counter[Deed]]  # By the name of the person


@dataclass(frozen=True, slots=True)
class MissionReport:
    mission: MissionExport
    map_name: str | None
    created_at: datetime
    ended_at: datetime | None
    revision: int
    way: Way
    objects: tuple[ExportObject, ...]  # At most `MAX_OBJECTS`
    object_count: int
    searches: Mapping[int, AreaSearch]  # By the id of the area; those not computed in time are missing
    people: People | None  # None for visitors


def gather(library: Library, mission_id: int, *, people: bool) -> MissionReport:
    """Read what the report of a mission says; `people`: include what only members get.

    Raises:
        NotFound: The mission does not exist.
    """
    mission = reading.read(library.database, mission_id, most=MAX_POSES, people=people)
    searches = search_areas(library, mission_id, budget_s=_COVERAGE_S)
    found = tuple(islice(mission.objects(), MAX_OBJECTS))
    with library.database.read() as session:
        row = session.get_one(Mission, mission_id)
        on = None if row.map_id is None else session.get(MapRecord, row.map_id)
        _, objects, _ = missions.counts(session, mission_id)
        return MissionReport(
            mission=mission,
            map_name=None if on is None else on.name,
            created_at=row.created_at,
            ended_at=row.ended_at,
            revision=row.revision,
            way=way.of_tracks(tracks.list_tracks(session, mission_id)),
            objects=found,
            object_count=objects,
            searches=searches,
            people=_people(session, row) if people else None,
        )


def _people(session: Session, mission: Mission) -> People:
    changes = select(ObjectChange).where(ObjectChange.mission_id == mission.id)
    ordered = changes.order_by(ObjectChange.time_s, ObjectChange.object_id, ObjectChange.number)
    return People(
        note=mission.note,
        robots=tuple(robots.list_robots(session, mission.id)),
        silences=tuple(reversed(robots.list_silences(session, mission.id))),
        silent_after_s=mission.silent_after_s,
        changes=tuple(session.scalars(ordered.limit(MAX_CHANGES))),
        deeds=_deeds(session, mission),
    )


def _deeds(session: Session, mission: Mission) -> dict[str, Counter[Deed]]:
    deeds: dict[str, Counter[Deed]] = {}

    def count(who: str | None, deed: Deed, *, times: int = 1) -> None:
        if who:
            deeds.setdefault(who, Counter())[deed] += times

    maker = None if mission.account_id is None else session.get(Account, mission.account_id)
    count(None if maker is None else maker.name, "made")
    for row in drawings.list_drawings(session, mission.id):
        count(row.created_by, "drew")
        count(row.searched_by, "searched")
    by_name = select(ObjectChange.by, func.count()).where(ObjectChange.mission_id == mission.id)
    for name, times in session.execute(by_name.group_by(ObjectChange.by).order_by(ObjectChange.by)):
        count(name, "set", times=times)
    for phone in phones.list_phones(session, mission):
        if phone.positions:
            count(phone.name, "phone")
    return deeds
