"""Data association: assigns detections without an id to known objects, or to new ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import and_, func, select
from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.association import ObjectAssociation, ObjectEstimate
from webapp.missions.core.trajectory.records import Sighting
from webapp.missions.store.schema import MissionObject, ObjectSighting

_MOST_PARAMETERS = 500


def identify(
    session: Session, mission_id: int, *, seen: Sequence[Sighting]
) -> tuple[list[tuple[str, Sighting]], dict[str, ObjectEstimate]]:
    """Find the object id of each sighting; sightings that have an id are never associated.

    Returns:
        In the same order, without the detections that are stored already.
        The associated objects among them, updated with these detections.
    """
    sent = sorted({one.object_id for one in seen if one.object_id is not None})
    anonymous = [one for one in seen if one.object_id is None]
    association = ObjectAssociation(_FreeIds(session, mission_id, taken=set(sent)).next)
    _load(session, mission_id, anonymous=anonymous, into=association)
    joined = iter(association.join(anonymous))
    renamed = _renamed(session, mission_id, sent=sent)
    found: list[tuple[str, Sighting]] = []
    estimates: dict[str, ObjectEstimate] = {}
    for one in seen:
        id = next(joined) if one.object_id is None else renamed.get(one.object_id, one.object_id)
        if id is None:
            continue
        found.append((id, one))
        if one.object_id is None:
            estimates[id] = association.estimate(one.kind, id)
    return found, estimates


@dataclass(slots=True)
class _FreeIds:
    """Generates unused ids from the class and a number: `victim #3`."""

    session: Session
    mission_id: int
    taken: set[str]
    _last: dict[str, int] = field(default_factory=dict)

    def next(self, kind: str) -> str:
        number = self._last.get(kind)
        if number is None:
            number = _count(self.session, self.mission_id, kind=kind)
        while True:
            number += 1
            id = f"{kind} #{number}"
            if id not in self.taken and self.session.get(MissionObject, (self.mission_id, id)) is None:
                self._last[kind] = number
                return id


def _count(session: Session, mission_id: int, *, kind: str) -> int:
    mine = (MissionObject.mission_id == mission_id, MissionObject.kind == kind, MissionObject.associated)
    return session.scalar(select(func.count()).where(*mine)) or 0


def _renamed(session: Session, mission_id: int, *, sent: list[str]) -> dict[str, str]:
    """Map ids given by senders to new ones if associated objects already have them."""
    renamed: dict[str, str] = {}
    for begin in range(0, len(sent), _MOST_PARAMETERS):
        some = MissionObject.object_id.in_(sent[begin : begin + _MOST_PARAMETERS])
        mine = (MissionObject.mission_id == mission_id, MissionObject.associated, some)
        renamed.update(
            (id, f"{id} (2)") for id in session.scalars(select(MissionObject.object_id).where(*mine))
        )
    return renamed


def _load(
    session: Session, mission_id: int, *, anonymous: Sequence[Sighting], into: ObjectAssociation
) -> None:
    """Load the objects to which detections may be assigned, and their sightings at the same times."""
    known: dict[str, ObjectEstimate] = {}
    kinds = sorted({one.kind for one in anonymous})
    mine = (MissionObject.mission_id == mission_id, MissionObject.associated)
    for begin in range(0, len(kinds), _MOST_PARAMETERS):
        some = MissionObject.kind.in_(kinds[begin : begin + _MOST_PARAMETERS])
        for row in session.execute(select(*_ESTIMATE).where(*mine, some).order_by(MissionObject.object_id)):
            id, kind, lat, lon, var_e, var_n, cov_en, first, last = row
            known[id] = ObjectEstimate(id, kind, LatLon(lat, lon), (var_e, var_n, cov_en), first, last)
            into.add(known[id])
    times = sorted({one.time_s for one in anonymous}) if known else []
    seen = (ObjectSighting.object_id, ObjectSighting.time_s, ObjectSighting.lat, ObjectSighting.lon)
    for begin in range(0, len(times), _MOST_PARAMETERS):
        some = ObjectSighting.time_s.in_(times[begin : begin + _MOST_PARAMETERS])
        found = select(*seen).where(and_(ObjectSighting.mission_id == mission_id, some))
        for id, time_s, lat, lon in session.execute(found):
            if id in known:
                into.add_seen(known[id], time_s=time_s, latlon=LatLon(lat, lon))


_ESTIMATE: tuple[Any, ...] = (
    MissionObject.object_id,
    MissionObject.kind,
    MissionObject.lat,
    MissionObject.lon,
    MissionObject.var_e,
    MissionObject.var_n,
    MissionObject.cov_en,
    MissionObject.first_time_s,
    MissionObject.last_time_s,
)
