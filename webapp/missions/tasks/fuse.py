"""Writes the fused track of a mission: its odometry corrected by its fixes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, or_, select
from sqlalchemy.orm import Session

from webapp.core.geometry.robust import GATE_2D
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.atomic import write_text
from webapp.missions.core.trajectory.fusion import MOST_POSES, Fusion, GatingResult, NoFusion, fuse
from webapp.missions.core.trajectory.planned import driven_tracks
from webapp.missions.core.trajectory.records import Poses, Source
from webapp.missions.core.trajectory.smoother import mean_distance_bounds
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, Track
from webapp.progress import Progress
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.schema import Job

JOB = "mission-fuse"

REPORT = "fusion.json"
"""File in the folder of the mission: report on the last fusion."""

LOCK = "fusion.lock"
"""Lock file in the inner folder of the library: held while a fused track and its report are written."""

MOST_TOLD = 1000
"""Maximum number of rejected fixes listed in a report."""

_MOST_NAMED = 10
"""Maximum number of tracks named in an error."""

_FIXES: tuple[Source, ...] = ("gps", "visual", "manual")

Write = Callable[[], AbstractContextManager[Session]]


@dataclass(frozen=True, slots=True, eq=False)
class SourceFixes:
    """The fixes of a track, and the number of each there, (m,) int64."""

    source: Source
    track: int
    poses: Poses
    kept: NDArray[np.int64]


def queue(session: Session, mission: Mission, *, account_id: int, odometry: int | None = None) -> Job:
    """Queue the fusion; `session` must be that of a write transaction. Raises UsageError."""
    _find_odometry(session, mission.id, odometry)
    return jobs.enqueue(
        session,
        JOB,
        map_id=mission.map_id,
        account_id=account_id,
        arguments={"mission": mission.id, "odometry": odometry},
        key=str(mission.id) if odometry is None else f"{mission.id}/{odometry}",
    )


def last_job(session: Session, mission: Mission, *, account_id: int) -> Job | None:
    """Find the last fusion that an account has queued."""
    mine = select(Job).where(Job.kind == JOB, Job.map_id == mission.map_id, Job.account_id == account_id)
    return session.scalar(mine.where(_of_mission(mission.id)).order_by(Job.id.desc()).limit(1))


def _of_mission(mission_id: int) -> ColumnElement[bool]:
    """Return the condition for fusions of a mission among those of all."""
    return or_(Job.key == str(mission_id), Job.key.startswith(f"{mission_id}/"))


@dataclass(frozen=True, slots=True)
class _Odometry:
    used: Track | None
    others: tuple[Track, ...]  # Driven too, but not used
    planned: tuple[Track, ...]


def _find_odometry(session: Session, mission_id: int, chosen: int | None) -> _Odometry:
    """Find the odometry to correct: that with the id `chosen`, or the longest.

    Raises:
        UsageError: The mission has no such track, or none is chosen of several from the same time.
    """
    found = [track for track in tracks.list_tracks(session, mission_id) if track.timed]
    moved = [track for track in found if track.source == "odometry"]
    names = driven_tracks(track.name for track in moved)
    driven = [track for track in moved if track.name in names]
    longest = max(driven, key=lambda t: t.distance_m, default=None)
    used = longest if chosen is None else next((t for t in moved if t.id == chosen), None)
    if chosen is not None and used is None:
        raise UsageError(
            f"the mission has no odometry with the id {chosen}", where="odometry", hint=_listed(moved)
        )
    if chosen is None and used is not None and any(_meet(used, t) for t in driven if t is not used):
        raise UsageError(
            "the mission has several tracks of odometry from the same time",
            where="odometry",
            hint=f"choose one by its id: {_listed(driven)}",
        )
    others = tuple(track for track in driven if track is not used)
    return _Odometry(used, others, tuple(track for track in moved if track not in (used, *driven)))


def _meet(a: Track, b: Track) -> bool:
    """Return whether two tracks were recorded at the same time."""
    a_begin, a_end, b_begin, b_end = (
        math.nan if time_s is None else time_s
        for time_s in (a.first_time_s, a.last_time_s, b.first_time_s, b.last_time_s)
    )
    return a_begin < b_end and b_begin < a_end


def _listed(found: Sequence[Track]) -> str:
    named = [f"{track.id} ({track.name or 'odometry'}, {track.distance_m:.0f} m)" for track in found]
    more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
    return (", ".join(named[:_MOST_NAMED]) or "it has none") + more


def fuse_mission(
    library: Library, mission_id: int, *, write: Write, progress: Progress, odometry: int | None = None
) -> dict[str, Any]:
    """Fuse odometry and fixes of a mission; the fused track is replaced atomically.

    Args:
        write: Opens a write transaction.
        odometry: Id of the track to correct; needed if there are several from the same time.

    Returns:
        The report, which is also stored in the mission's folder.

    Raises:
        UsageError: The mission cannot be fused, for instance without fixes, or with several tracks of
            odometry of which none is chosen.
        NotFound: The mission no longer exists.
        Cancelled
    """
    with library.database.read() as session:
        session.get_one(Mission, mission_id)
        found = [track for track in tracks.list_tracks(session, mission_id) if track.timed]
        moved = _find_odometry(session, mission_id, odometry)
        path = None if moved.used is None else _read(session, moved.used)[0]
        fixed = {name: one for source in _FIXES for name, one in _fixes(session, found, source).items()}
    progress.size(3)
    progress.note("fusing odometry and fixes")
    fusion = fuse(path, {s: f.poses for s, f in fixed.items()}, check=lambda _: progress.check())
    if isinstance(fusion, NoFusion):
        raise UsageError(
            fusion.reason, where=f"mission {mission_id}", hint="send GPS positions, or photos to be localized"
        )
    progress.advance(2)
    gated = [one for name, fixes in fixed.items() for one in _gated(fusion.gating[name], fixes)]
    report = _report(fusion, fixed, odometry=moved.used)
    report |= {"gated": sorted(gated, key=lambda one: one["time_s"])[:MOST_TOLD]}
    report |= {"others": [track.id for track in moved.others], "planned": [t.id for t in moved.planned]}
    while not _kept(library, mission_id, write=write, poses=fusion.poses, gated=gated, report=report):
        with FileLock(library.inner / LOCK):
            pass  # wait outside the write transaction, so as not to block other writers
    progress.advance()
    return report


def read_report(library: Library, mission_id: int) -> dict[str, Any]:
    """Read the report on the last fusion.

    Raises:
        NotFound: The mission was never fused, or its fused track was removed.
    """
    path = missions.folder(library, mission_id) / REPORT
    with library.database.read() as session:
        found = any(track.source == "fused" for track in tracks.list_tracks(session, mission_id))
    if not found or not path.is_file():
        raise NotFound("the tracks of this mission have not been fused yet", where=f"mission {mission_id}")
    return cast(dict[str, Any], json.loads(path.read_text(encoding="utf-8")))


def remove(library: Library, mission_id: int, *, write: Write) -> None:
    """Delete the fused track, its report and its marks on photos; the tracks that were fused stay.

    Fusions that wait or run are cancelled, as they would bring it back.

    Raises:
        NotFound: There is no fused track, and none is being made.
        Conflict: A backup is running.
    """
    with ExitStack() as held:
        try:
            with write() as session:
                cancelled = _cancel_all(session, mission_id)  # before the mission is locked, as jobs do
                mission = session.get_one(Mission, mission_id, with_for_update=True)
                _remove_track(session, mission, needed=not cancelled)
                held.enter_context(FileLock(library.inner / LOCK, timeout=0))
        except Timeout:
            where, hint = f"mission {mission_id}", "try again when it has ended"
            raise Conflict("a backup of the library is running", where=where, hint=hint) from None
        (missions.folder(library, mission_id) / REPORT).unlink(missing_ok=True)


def _cancel_all(session: Session, mission_id: int) -> bool:
    """Cancel the fusions of a mission that wait or run; return whether there were any."""
    alive = select(Job).where(Job.kind == JOB, _of_mission(mission_id), Job.state.in_(jobs.LIVE))
    found = list(session.scalars(alive.order_by(Job.id).with_for_update()))
    for job in found:
        jobs.cancel(session, job)
    return bool(found)


def _remove_track(session: Session, mission: Mission, *, needed: bool) -> None:
    """Delete the fused track and its marks. Raises NotFound if there is none though it is needed."""
    found = [track for track in tracks.list_tracks(session, mission.id) if track.source == "fused"]
    if needed and not found:
        raise NotFound("the mission has no corrected track", where=f"mission {mission.id}")
    for track in found:
        tracks.clear(session, track)
        session.delete(track)
    for photo in missions.photos(session, mission.id):
        if photo.fix is not None and "gated" in photo.fix:
            photo.fix = {k: v for k, v in photo.fix.items() if k not in ("gated", "gated_why")}
    if found:
        missions.count_change(mission)


def _kept(
    library: Library,
    mission_id: int,
    *,
    write: Write,
    poses: Poses,
    gated: list[dict[str, Any]],
    report: dict[str, Any],
) -> bool:
    """Replace the fused track and its report; return False, with nothing changed, if a backup is running."""
    with ExitStack() as held:
        try:
            with write() as session:
                mission = session.get_one(Mission, mission_id, with_for_update=True)
                track = tracks.get_or_create(session, mission_id, source="fused")
                tracks.clear(session, track)
                tracks.append(session, track, poses)
                tracks.inherit_thinning(track, _inputs(session, mission_id, report))
                _mark_photos(session, mission_id, gated)
                missions.count_change(mission)
                report |= {"track": track.id, "revision": mission.revision}
                held.enter_context(FileLock(library.inner / LOCK, timeout=0))
        except Timeout:
            return False
        folder = missions.folder(library, mission_id)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / REPORT, json.dumps(report))
    return True


def _inputs(session: Session, mission_id: int, report: dict[str, Any]) -> list[Track]:
    sources = {fixes["source"] for fixes in report["fixes"]}
    found = [track for track in tracks.list_tracks(session, mission_id) if track.timed]
    return [track for track in found if track.id == report["odometry"] or track.source in sources]


def _read(session: Session, track: Track) -> tuple[Poses, NDArray[np.int64]]:
    """Read a track, subsampled to `MOST_POSES`, with the numbers of the poses."""
    if track.poses <= MOST_POSES:
        return tracks.read(session, track), np.arange(track.poses)
    numbers = np.linspace(0, track.poses - 1, MOST_POSES).astype(np.int64)
    return tracks.at(session, track, numbers.tolist()), numbers


def _fixes(session: Session, found: list[Track], source: Source) -> dict[str, SourceFixes]:
    """Read the fixes of a source; of several receivers or cameras, each has a name of its own."""
    mine = [track for track in found if track.source == source and track.poses]
    return {
        source if len(mine) == 1 else f"{source} {track.id}": SourceFixes(
            source, track.id, *_read(session, track)
        )
        for track in mine
    }


def _report(fusion: Fusion, fixed: Mapping[str, SourceFixes], *, odometry: Track | None) -> dict[str, Any]:
    fit = fusion.fit
    return {
        "odometry": None if odometry is None else odometry.id,
        "odometry_name": None if odometry is None else odometry.name,
        "poses": len(fusion.poses),
        "errors": {"odometry": fit.odometry, "receiver": fit.stated.get("gps", 1.0), "stated": fit.stated},
        "too_sure": [
            {**_named(fixed[one.source]), "factor": one.factor, "since_s": one.since_s}
            for one in fit.too_sure
        ],
        "shifted": [
            {
                **_named(fixed[one.source]),
                "from_s": one.begin_s,
                "to_s": one.end_s,
                "fixes": one.fixes,
                "east_m": one.east_m,
                "north_m": one.north_m,
            }
            for one in fusion.shifts
        ],
        "pieces": list(fusion.begins_s),
        "fixes": [_statistics(fusion.gating[name], one) for name, one in fixed.items()],
    }


def _named(fixes: SourceFixes) -> dict[str, Any]:
    return {"source": fixes.source, "track": fixes.track}


def _statistics(gating: GatingResult, fixes: SourceFixes) -> dict[str, Any]:
    used = int((~gating.gated).sum())
    return {
        **_named(fixes),
        "used": used,
        "gated": int(gating.gated.sum()),
        "mean_distance": gating.mean_distance if used else None,
        "expected_between": list(mean_distance_bounds(used)) if used else None,
    }


def _gated(gating: GatingResult, fixes: SourceFixes) -> list[dict[str, Any]]:
    rejected = []
    for at in np.flatnonzero(gating.gated).tolist():
        number = int(gating.number[at])
        off, distance = float(gating.innovation_m[at]), float(gating.distance[at])
        most = off * math.sqrt(GATE_2D / distance)
        lat, lon = fixes.poses.latlon[number].tolist()
        expected_lat, expected_lon = gating.expected[at].tolist()
        rejected.append(
            {
                **_named(fixes),
                "number": int(fixes.kept[number]),
                "time_s": float(fixes.poses.times_s[number]),
                "lat": lat,
                "lon": lon,
                "expected": {"lat": expected_lat, "lon": expected_lon},
                "off_m": off,
                "most_m": most,
                "distance": distance,
                "reason": f"{off:.1f} m from where it was expected; {_why(off, most)}",
            }
        )
    return rejected


def _why(off: float, most: float) -> str:
    if off > most:
        return f"only one good fix in a thousand is more than {most:.1f} m off"
    return "by all fixes together, it is more probably wrong, or off like those around it"


def _mark_photos(session: Session, mission_id: int, gated: list[dict[str, Any]]) -> None:
    """Note for each photo whether its fix was rejected."""
    left_out = {
        (one["time_s"], one["lat"], one["lon"]): one["reason"] for one in gated if one["source"] == "visual"
    }
    for photo in missions.photos(session, mission_id):
        if photo.fix is not None and photo.fix.get("lat") is not None:
            reason = left_out.get((photo.fix["time"], photo.fix["lat"], photo.fix["lon"]))
            photo.fix = {**photo.fix, "gated": reason is not None, "gated_why": reason}
