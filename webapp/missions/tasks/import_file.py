"""Takes a file with tracks and objects into a mission, each pose once, however often it is begun.

The file is read twice: first all of it is checked and nothing is stored; then its parts, which are the same
each time that it is read, are stored a few at a time, in one transaction with how many of them are there.
A killed import continues after the last of them; who imports a file again finds all of them there.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.records import Sighting, Source
from webapp.core.trajectory.robotframe import Start
from webapp.errors import NotFound, TrackError
from webapp.missions.files.track_chunks import Findings, Skipped
from webapp.missions.files.track_format import TITLES, Kind, kind_of
from webapp.missions.store import batches, missions, tracks
from webapp.missions.store.schema import Mission, MissionSender, Track
from webapp.missions.tasks import read_track
from webapp.missions.tasks.import_order import Order, options_key
from webapp.missions.tasks.place_track import TrackSegment
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.database import Writes
from webapp.store.library import Library
from webapp.store.schema import MapRecord

_AT_ONCE = 8192
"""Poses and objects in one transaction, and some."""

_MAX_NAME = 200
_BLOCK = 1 << 20
_NUMBERED = re.compile(r"(waypoint|placemark|point) ")
"""Begins the ids that readers give: the file's name distinguishes those of several files."""

Part = TrackSegment | tuple[Sighting, ...]
Key = tuple[Source, str]


@dataclass(frozen=True, slots=True)
class MissionToMake:
    """A mission that is made together with the first that is stored: a file that cannot be read makes none.

    Attributes
    ----------
    account_id : int
        Who makes it.
    map_id : int or None
        None for one on the globe.
    made : callable
        Called with the session that makes it, and its id: an import that begins again needs it.
    """

    name: str
    account_id: int
    map_id: int | None
    made: Callable[[Session, int], None]


@dataclass(frozen=True, slots=True)
class ImportedTrack:
    """A track from the file; the attributes are those of the track in the mission."""

    id: int
    source: str
    name: str
    poses: int
    skipped: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class TrackImport:
    """The result of an import.

    Attributes
    ----------
    mission : int
        Where it is now.
    kind : str
        What the file is, for people.
    objects : int
        Sightings of objects in the file.
    new : bool
        Whether anything of it was not there before.
    skipped : tuple of Skipped
        What could not be used, and why.
    doubts : tuple of Skipped
        What was taken as it stands, and can hardly be true.
    notes : tuple of str
        How the file was understood.
    """

    mission: int
    kind: str
    tracks: tuple[ImportedTrack, ...]
    objects: int
    new: bool
    skipped: tuple[Skipped, ...]
    doubts: tuple[Skipped, ...]
    notes: tuple[str, ...]


def import_track_file(
    library: Library,
    into: int | MissionToMake,
    *,
    order: Order,
    settings: Settings,
    progress: Progress | None = None,
    writes: Writes | None = None,
) -> TrackImport:
    """Import a file.

    Parameters
    ----------
    into : int or MissionToMake
        Id of the mission.
    progress : Progress, optional
        One step a pose or object.
    writes : callable, optional
        Opens the session that writes: that of a job that holds its lease.

    Raises
    ------
    NotFound
        The mission is gone, or in the bin.
    TrackError, UsageError
        The file cannot be read, or has nothing that can be used: nothing was stored.
    Cancelled
        What was stored stays; the same import continues.
    """
    progress, write = progress or Progress(), writes or library.database.write
    if isinstance(into, int):
        order = _with_start(library, into, order)
    key = _key(order, progress)
    findings = Findings()
    with _called(order):
        survey = _survey(order, findings, progress)
    with write() as session:
        mission = _mission(session, into) if isinstance(into, int) else _made(session, into)
        mission_id = mission.id
        ids = _tracks(session, mission, survey.tracks, key=key, name=order.name)
        if mission.start is None and order.options.start is not None:
            given = order.options.start
            mission.start = {**given.position._asdict(), "heading_deg": given.heading_deg}
        stored = _stored(session, mission_id, key)
    progress.size(survey.records)
    progress.note("storing")
    for first, group in _groups(_parts(order, progress), stored):
        with write() as session:
            mission = _mission(session, mission_id)
            missing = group[max(_stored(session, mission_id, key) - first, 0) :]
            batches.advance(session, mission_id, sender=key, first=first, count=len(group))
            if missing:
                missions.count_change(mission)
                _store(session, mission, parts=missing, ids=ids)
    with library.database.read() as session:
        found = [session.get_one(Track, id) for id in ids.values()]
        made = tuple(ImportedTrack(t.id, t.source, t.name, t.poses, t.skipped, t.distance_m) for t in found)
    kind = TITLES[survey.kind]
    new = stored < survey.parts
    return TrackImport(
        mission_id,
        kind,
        made,
        survey.objects,
        new,
        findings.skipped(),
        findings.doubts(),
        tuple(findings.notes),
    )


@dataclass(frozen=True, slots=True)
class _Survey:
    """What a file has."""

    kind: Kind
    tracks: dict[Key, bool]
    """And whether they have times."""
    parts: int
    records: int
    objects: int


def _survey(order: Order, findings: Findings, progress: Progress) -> _Survey:
    progress.note("reading")
    seen: dict[Key, bool] = {}
    parts = records = objects = 0
    for part in read_track.stream(
        order.path, options=order.options, findings=findings, progress=_SilentProgress(progress)
    ):
        parts += 1
        if isinstance(part, TrackSegment):
            key = (part.source, part.track)
            seen[key] = seen.get(key, False) or part.timed
            records += len(part.poses) + part.skipped
        else:
            objects += len(part)
    kind = kind_of(order.path, table=order.options.columns is not None)
    return _Survey(kind, seen, parts, records + objects, objects)


def _parts(order: Order, progress: Progress) -> Iterator[Part]:
    """Read the file once more, with objects that are called after it where they have no ids of their own."""
    stem = PurePath(order.name).stem
    for part in read_track.stream(order.path, options=order.options, findings=Findings(), progress=progress):
        if isinstance(part, TrackSegment):
            yield part
        else:
            yield tuple(_called_after(one, stem) for one in part)


def _called_after(seen: Sighting, stem: str) -> Sighting:
    if seen.object_id is None or not _NUMBERED.match(seen.object_id):
        return seen
    return replace(seen, object_id=f"{stem}: {seen.object_id}"[:_MAX_NAME])


def _groups(parts: Iterator[Part], stored: int) -> Iterator[tuple[int, list[Part]]]:
    """Return the parts that are not stored yet, a few at a time, with the number of the first."""
    group: list[Part] = []
    size = first = 0
    for number, part in enumerate(parts):
        if number < stored:
            continue
        if not group:
            first = number
        group.append(part)
        size += len(part.poses) if isinstance(part, TrackSegment) else len(part)
        if size >= _AT_ONCE:
            yield first, group
            group, size = [], 0
    if group:
        yield first, group


def _stored(session: Session, mission_id: int, key: str) -> int:
    """Count the parts that are stored, also by somebody who imports the same at the same time."""
    sender = session.get(MissionSender, (mission_id, key))
    return 0 if sender is None else sender.next_seq


def _store(session: Session, mission: Mission, *, parts: list[Part], ids: dict[Key, int]) -> None:
    for part in parts:
        if isinstance(part, TrackSegment):
            track = session.get_one(Track, ids[(part.source, part.track)])
            tracks.append(session, track, poses=part.poses, skipped=part.skipped)
            track.distance_m = (
                part.travelled_m
            )  # to the end of the file, not only to the last pose that is kept
    seen = [one for part in parts if not isinstance(part, TrackSegment) for one in part]
    batches.add_sightings(session, mission, seen=seen)


def _tracks(
    session: Session, mission: Mission, found: dict[Key, bool], *, key: str, name: str
) -> dict[Key, int]:
    """Find the tracks that this import has made before, or make new ones; no other program's are used."""
    known = batches.answered(session, mission.id, key=key)
    if known is not None:
        return {(source, track): id for source, track, id in known["tracks"]}
    made = {}
    for (source, track), timed in found.items():
        free = _free(session, mission, source, title=read_track.title(name, track))
        row = tracks.get_or_create(session, mission.id, source=source, name=free)
        row.timed, made[(source, track)] = timed, row.id
    listed = [[source, track, id] for (source, track), id in made.items()]
    batches.remember(session, mission.id, key, answer={"tracks": listed})
    return made


def _free(session: Session, mission: Mission, source: Source, *, title: str) -> str:
    same = select(Track.name).where(Track.mission_id == mission.id, Track.source == source)
    taken = set(session.scalars(same))
    number, name = 1, title
    while name in taken:
        number += 1
        name = f"{title} ({number})"
    return name


def _mission(session: Session, mission_id: int) -> Mission:
    mission = session.get(Mission, mission_id, with_for_update=True)
    if mission is None or mission.binned_at is not None:
        raise NotFound("the mission was not found, or is in the bin", where=f"mission {mission_id}")
    return mission


def _made(session: Session, new: MissionToMake) -> Mission:
    if new.map_id is not None and session.get(MapRecord, new.map_id) is None:
        raise NotFound("the map of the new mission is gone", hint="choose another one")
    mission = missions.create(session, new.name, account_id=new.account_id, map_id=new.map_id)
    new.made(session, mission.id)
    return mission


def _with_start(library: Library, mission_id: int, order: Order) -> Order:
    if order.options.start is not None:
        return order
    with library.database.read() as session:
        mission = session.get(Mission, mission_id)
        known: dict[str, Any] | None = None if mission is None else mission.start
    if known is None:
        return order
    start = Start(LatLon(known["lat"], known["lon"]), known["heading_deg"])
    return replace(order, options=replace(order.options, start=start))


def _key(order: Order, progress: Progress) -> str:
    """Name an import after what is in the file and how it is read."""
    files = [order.path]
    if order.path.is_dir():
        files = sorted(path for path in order.path.iterdir() if path.is_file())
    digest = hashlib.sha256(options_key(order.options).encode())
    try:
        for path in files:
            with path.open("rb") as file:
                while block := file.read(_BLOCK):
                    progress.check()
                    digest.update(block)
    except OSError as error:
        message = f"the file cannot be read: {error.strerror or error}"
        raise TrackError(message, where=order.name, hint="check its path") from error
    return f"{batches.FILE}{digest.hexdigest()[:32]}"


@contextmanager
def _called(order: Order) -> Iterator[None]:
    """Call a file in errors as its sender does."""
    try:
        yield
    except TrackError as error:
        error.where = (error.where or order.name).replace(order.path.name, order.name)
        raise


class _SilentProgress(Progress):
    """Shows nothing, and can be cancelled where another can."""

    def __init__(self, other: Progress) -> None:
        self._other = other

    def cancelled(self) -> bool:
        return self._other.cancelled()
