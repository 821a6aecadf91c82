"""Imports a file with tracks and objects into a mission; the import is idempotent.

The file is read twice: first all of it is checked without storing anything; then its parts, which are
deterministic, are stored a few at a time, each transaction including the number of parts stored. A killed
import continues after the last stored part, and importing a file again stores nothing.
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
from webapp.errors import NotFound, TrackError
from webapp.files.gate import budget_for
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.records import Sighting, Source
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.files.drawn import FoundDrawing
from webapp.missions.files.track_chunks import Findings, Skipped
from webapp.missions.files.track_format import TrackFormat
from webapp.missions.files.track_reader import FORMATS, kind_of
from webapp.missions.store import batches, drawings, missions, tracks
from webapp.missions.store.schema import Mission, MissionSender, Track
from webapp.missions.tasks import read_track
from webapp.missions.tasks.import_order import Order, options_key
from webapp.missions.tasks.place_track import TrackSegment
from webapp.progress import Progress
from webapp.settings import FileLimits, Settings
from webapp.store.database import Writes
from webapp.store.library import Library
from webapp.store.schema import MapRecord

_AT_ONCE = 8192
"""Approximate number of poses and objects in one transaction."""

_MAX_NAME = 200
_BLOCK = 1 << 20
_NUMBERED = re.compile(f"({'|'.join({entry.numbered for entry in FORMATS.values() if entry.numbered})}) ")
"""Matches ids that readers generate; the file's name is prefixed to make them unique across files."""

Part = TrackSegment | tuple[Sighting, ...]
Key = tuple[Source, str]


@dataclass(frozen=True, slots=True)
class MissionToMake:
    """A mission to be created once the file was checked, so that an unreadable file creates none."""

    name: str
    account_id: int  # Creator of the mission
    map_id: int | None  # None for a mission without a map
    # Called with the session that creates the mission, and its id, which a restarted import needs.
    made: Callable[[Session, int], None]


@dataclass(frozen=True, slots=True)
class ImportedTrack:
    """An imported track; the attributes are those of the track in the mission."""

    id: int
    source: str
    name: str
    poses: int
    skipped: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class TrackImport:
    mission: int  # Id of the mission
    kind: str  # Format of the file, for display
    tracks: tuple[ImportedTrack, ...]
    objects: int  # Number of sightings of objects in the file
    new: bool  # Whether anything was stored that was not imported before
    skipped: tuple[Skipped, ...]  # Items that could not be used, with reasons
    doubts: tuple[Skipped, ...]  # Implausible items that were imported unchanged
    notes: tuple[str, ...]  # How the file was interpreted


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

    Args:
        into: Id of the mission.
        progress: One step per pose or object.
        writes: Opens a write transaction, such as that of a job, which requires its lease.

    Raises:
        NotFound: The mission no longer exists, or is in the bin.
        TrackError, UsageError: The file cannot be read, or has no usable content: nothing was stored.
        Cancelled: Parts that are stored are kept; importing the file again continues after them.
    """
    progress, write = progress or Progress(), writes or library.database.write
    limits = settings.files
    if isinstance(into, int):
        order = _with_start(library, into, order)
    key = _key(order, progress)
    findings = Findings()
    with _called(order):
        survey = _survey(order, findings, progress, limits=limits)
    with write() as session:
        mission = _mission(session, into) if isinstance(into, int) else _made(session, into)
        mission_id = mission.id
        ids = _tracks(session, mission, survey, key=key, name=order.name)
        if mission.start is None and order.options.start is not None:
            given = order.options.start
            mission.start = {**given.position._asdict(), "heading_deg": given.heading_deg}
        stored = _stored(session, mission_id, key)
        if ids.keys() != survey.tracks.keys():  # an older version imported it, and divided it otherwise
            _check_complete(session, ids, survey, name=order.name)
            stored = max(stored, survey.parts)
    progress.size(survey.records)
    progress.note("storing")
    for first, group in _groups(_parts(order, progress, limits=limits), stored):
        with write() as session:
            mission = _mission(session, mission_id)
            missing = group[max(_stored(session, mission_id, key) - first, 0) :]
            batches.advance(session, mission_id, sender=key, first=first, count=len(group))
            if missing:
                missions.count_change(mission)
                _store(session, mission, parts=missing, ids=ids)
    drawn = False
    if findings.drawn:
        with write() as session:
            drawn = _store_drawings(session, _mission(session, mission_id), findings.drawn, by=order.name)
    with library.database.read() as session:
        found = [session.get_one(Track, id) for id in ids.values()]
        made = tuple(ImportedTrack(t.id, t.source, t.name, t.poses, t.skipped, t.distance_m) for t in found)
    kind = survey.kind.title
    new = stored < survey.parts or drawn
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
    kind: TrackFormat
    tracks: dict[Key, bool]
    """Tracks, and whether they have times."""
    looks: dict[str, TrackLook]
    """How tracks look, by their names in the file, as far as it says."""
    parts: int
    records: int
    objects: int


def _survey(order: Order, findings: Findings, progress: Progress, *, limits: FileLimits) -> _Survey:
    progress.note("reading")
    seen: dict[Key, bool] = {}
    parts = records = objects = 0
    for part in read_track.stream(
        order.path,
        options=order.options,
        findings=findings,
        progress=_SilentProgress(progress),
        budget=budget_for(order.path, limits),
    ):
        parts += 1
        if isinstance(part, TrackSegment):
            key = (part.source, part.track)
            seen[key] = seen.get(key, False) or part.timed
            records += len(part.poses) + part.skipped
        else:
            objects += len(part)
    kind = kind_of(order.path, table=order.options.columns is not None)
    return _Survey(kind, seen, findings.looks, parts, records + objects, objects)


def _parts(order: Order, progress: Progress, *, limits: FileLimits) -> Iterator[Part]:
    """Read the file, prefixing generated ids of objects with its name."""
    stem = PurePath(order.name).stem
    budget = budget_for(order.path, limits)
    for part in read_track.stream(
        order.path, options=order.options, findings=Findings(), progress=progress, budget=budget
    ):
        if isinstance(part, TrackSegment):
            yield part
        else:
            yield tuple(_called_after(one, stem) for one in part)


def _called_after(seen: Sighting, stem: str) -> Sighting:
    if seen.object_id is None or not _NUMBERED.match(seen.object_id):
        return seen
    return replace(seen, object_id=f"{stem}: {seen.object_id}"[:_MAX_NAME])


def _groups(parts: Iterator[Part], stored: int) -> Iterator[tuple[int, list[Part]]]:
    """Yield the parts that are not stored yet, in groups, with the number of the first."""
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
    """Return the number of parts stored, also by a concurrent import of the same file."""
    sender = session.get(MissionSender, (mission_id, key))
    return 0 if sender is None else sender.next_seq


def _check_complete(session: Session, ids: dict[Key, int], survey: _Survey, *, name: str) -> None:
    """Check that tracks that are divided otherwise have all poses of the file. Raises TrackError."""
    found = [track for id in ids.values() if (track := session.get(Track, id)) is not None]
    if sum(track.poses + track.skipped + track.removed for track in found) < survey.records - survey.objects:
        raise TrackError(
            "only a part of the file was imported, by a version that divided it into other tracks",
            where=name,
            hint="import it into a new mission",
        )


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


def _store_drawings(session: Session, mission: Mission, found: list[FoundDrawing], *, by: str) -> bool:
    """Add the drawings that the mission does not have; return whether there were any."""
    new = [
        one
        for one in found
        if not drawings.has_same(session, mission.id, kind=one.kind, name=one.name, points=one.points)
    ]
    for one in new:
        drawings.add(session, mission, kind=one.kind, by=by, fields=one.fields())
    return bool(new)


def _tracks(session: Session, mission: Mission, survey: _Survey, *, key: str, name: str) -> dict[Key, int]:
    """Find the tracks that an earlier run of this import created, or create new ones."""
    known = batches.answered(session, mission.id, key=key)
    if known is not None:
        return {(source, track): id for source, track, id in known["tracks"]}
    made = {}
    titles = {tracks.look_of(row).title for row in tracks.list_tracks(session, mission.id)}
    for (source, track), timed in survey.tracks.items():
        free = _free(session, mission, source, title=read_track.title(name, track))
        row = tracks.get_or_create(session, mission.id, source=source, name=free)
        row.timed, made[(source, track)] = timed, row.id
        look = survey.looks.get(track, TrackLook())
        if look.title in titles:  # their names, which contain those of the files, differ
            look = replace(look, title="")
        titles.add(look.title)
        row.look = look.fields()
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
    """Return the key of an import: a hash of the file's content and the options."""
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
    """Replace the path in errors by the original name of the file."""
    try:
        yield
    except TrackError as error:
        error.where = (error.where or order.name).replace(order.path.name, order.name)
        raise


class _SilentProgress(Progress):
    """Shows nothing, but is cancelled together with another one."""

    def __init__(self, other: Progress) -> None:
        self._other = other

    def cancelled(self) -> bool:
        return self._other.cancelled()
