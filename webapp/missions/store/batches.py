"""Batches of records that robots send: each record is stored exactly once, however often it is sent.

A client that numbers its records sends its name and the number of the first record of a batch: stored records
are skipped, and gaps are refused. A client without numbers gives each batch an idempotency key: a repeated
key gets the first answer again. Either way, this is one transaction with the records themselves.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

from sqlalchemy import and_, delete, func, insert, select
from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.errors import Conflict
from webapp.missions.core.trajectory.association import ObjectAssociation, ObjectEstimate
from webapp.missions.core.trajectory.batch import Batch
from webapp.missions.core.trajectory.records import Sighting
from webapp.missions.store import missions, robots, tracks
from webapp.missions.store.objects import STATES
from webapp.missions.store.schema import Mission, MissionBatch, MissionObject, MissionSender, ObjectSighting
from webapp.store.clock import now

_MOST_PARAMETERS = 500
_UNKNOWN = (None, None, None)

FILE = "import:"
"""Prefix of the batch keys and sender names of imported files; the API does not accept it from clients."""


class OutOfOrder(Conflict):
    """Records are missing before these.

    Args:
        next_seq: Number of the record that is expected next.
    """

    def __init__(self, next_seq: int) -> None:
        super().__init__(
            "records before these are missing",
            where="first",
            hint=f"send from record {next_seq} on; make sure that no other program "
            "uses the name of this sender",
        )
        self.next_seq = next_seq


def locked(session: Session, mission_id: int) -> Mission:
    """Lock a mission for writing; other writers wait.

    Raises:
        NotFound: The mission was deleted in the meantime.
    """
    return session.get_one(Mission, mission_id, with_for_update=True)


def advance(session: Session, mission_id: int, sender: str, *, first: int, count: int) -> tuple[int, int]:
    """Advance the record counter of a sender, in the transaction that stores the records.

    Args:
        first: Number of the first record.

    Returns:
        Number of these records that are stored already.
        Number of the record that is expected next.

    Raises:
        OutOfOrder: Records before these are missing.
    """
    row = session.get(MissionSender, (mission_id, sender))
    known = 0 if row is None else row.next_seq
    if first > known:
        raise OutOfOrder(known)
    next_seq = max(known, first + count)
    if row is None and count:
        session.add(MissionSender(mission_id=mission_id, sender=sender, next_seq=next_seq))
    if row is not None:
        row.next_seq, row.seen_at = next_seq, now()
    return min(known - first, count), next_seq


def answered(session: Session, mission_id: int, key: str) -> dict[str, Any] | None:
    """Find the answer to an earlier batch with the same key; None for a new key."""
    found = session.get(MissionBatch, (mission_id, key))
    return None if found is None else found.answer


def remember(
    session: Session, mission_id: int, key: str, *, answer: dict[str, Any], keep: timedelta | None = None
) -> None:
    """Store the answer to a batch, in case it is sent again.

    Args:
        keep: Older answers to clients are deleted. Results of files, whose keys begin with `FILE`, are kept,
            as a file may be imported again at any time.
    """
    if keep is not None:
        old = (MissionBatch.mission_id == mission_id, MissionBatch.at < now() - keep)
        session.execute(delete(MissionBatch).where(*old, ~MissionBatch.key.startswith(FILE)))
    session.add(MissionBatch(mission_id=mission_id, key=key, answer=answer))


def store(session: Session, mission: Mission, batch: Batch) -> None:
    """Store the records of a batch; this counts as one change of the mission."""
    missions.count_change(mission)
    for (source, name), part in batch.tracks.items():
        track = tracks.get_or_create(session, mission.id, source=source, name=name)
        tracks.append(session, track, part.poses, skipped=part.skipped)
        if part.travelled_m > track.distance_m:  # false for NaN
            track.distance_m = part.travelled_m
    add_sightings(session, mission, batch.sightings)
    robots.add_statuses(session, mission.id, found=batch.statuses)
    names = {name for _, name in batch.tracks} | {one.robot for one in batch.statuses}
    if not names and batch.sightings:
        names = {""}
    robots.hear(session, mission, names=names, at_s=time.time())
    if batch.ends:
        missions.end(mission)


def add_sightings(session: Session, mission: Mission, seen: Sequence[Sighting]) -> None:
    """Add sightings of new and known objects, and associate those without an id.

    The position of an object is that of its latest sighting; that of an associated one is the weighted mean
    of all its detections. The caller must call `missions.count_change` before.
    """
    identified, estimates = _identify(session, mission.id, seen=seen)
    known = _known(session, mission.id, sorted({id for id, _ in identified}))
    rows = []
    for id, sighting in identified:
        found = known.get(id)
        if found is None:
            found = known[id] = _new(mission, id, sighting)
            session.add(found)
        rows.append(_row(found, sighting))
        _update(found, sighting, revision=mission.revision)
    for id, estimate in estimates.items():
        known[id].associated = True
        known[id].lat, known[id].lon = estimate.latlon
        known[id].var_e, known[id].var_n, known[id].cov_en = estimate.covariance_m2
    if rows:
        session.flush()
        session.connection().execute(insert(ObjectSighting.__table__), rows)  # type: ignore[arg-type]


def _known(session: Session, mission_id: int, ids: list[str]) -> dict[str, MissionObject]:
    found: dict[str, MissionObject] = {}
    for begin in range(0, len(ids), _MOST_PARAMETERS):
        some = MissionObject.object_id.in_(ids[begin : begin + _MOST_PARAMETERS])
        rows = session.scalars(select(MissionObject).where(MissionObject.mission_id == mission_id, some))
        found.update({row.object_id: row for row in rows})
    return found


def _new(mission: Mission, id: str, seen: Sighting) -> MissionObject:
    return MissionObject(
        mission_id=mission.id,
        object_id=id,
        kind=seen.kind,
        first_time_s=seen.time_s,
        last_time_s=seen.time_s,
        lat=seen.latlon.lat,
        lon=seen.latlon.lon,
        state=seen.state if seen.state in STATES else "found",
        sightings=0,
    )


def _update(known: MissionObject, seen: Sighting, *, revision: int) -> None:
    known.sightings += 1
    known.revision = revision
    known.first_time_s = min(known.first_time_s, seen.time_s)
    if seen.time_s >= known.last_time_s:
        known.kind = seen.kind
        known.last_time_s = seen.time_s
        known.lat, known.lon = seen.latlon
        known.height_m, known.confidence = seen.height_m, seen.confidence
        known.var_e, known.var_n, known.cov_en = seen.covariance_m2 or _UNKNOWN
        if seen.size_m is not None:
            known.size_x_m, known.size_y_m, known.size_z_m = seen.size_m
        known.photo_sha = seen.photo or known.photo_sha


def _row(of: MissionObject, seen: Sighting) -> dict[str, Any]:
    var_e, var_n, cov_en = seen.covariance_m2 or _UNKNOWN
    size_x_m, size_y_m, size_z_m = seen.size_m or _UNKNOWN
    return {
        "mission_id": of.mission_id,
        "object_id": of.object_id,
        "number": of.sightings,
        "time_s": seen.time_s,
        "lat": seen.latlon.lat,
        "lon": seen.latlon.lon,
        "height_m": seen.height_m,
        "var_e": var_e,
        "var_n": var_n,
        "cov_en": cov_en,
        "size_x_m": size_x_m,
        "size_y_m": size_y_m,
        "size_z_m": size_z_m,
        "confidence": seen.confidence,
        "photo_sha": seen.photo,
    }


def _identify(
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
