"""Thins tracks of missions that are over to fewer poses, or to both ends; by rule or on demand.

Each track is replaced in one transaction, so that a killed job leaves it either unchanged or thinned, and
later continues with the next one. The rows of removed poses are deleted afterwards, block by block, so that
others can write in between; if that is interrupted, the track is due again.

Only poses are removed: objects, sightings and photos stay, and so do the first and the last pose of a track,
its length, times and extent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
from sqlalchemy import ColumnElement, or_, select
from sqlalchemy.orm import Session

from webapp.errors import Conflict, NotFound
from webapp.missions.core.trajectory.records import Poses, join
from webapp.missions.core.trajectory.thinning import GAP_S, simplify_motion
from webapp.missions.store import tracks
from webapp.missions.store.schema import Mission, Track
from webapp.progress import Progress
from webapp.settings import MissionSettings, Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.operate import jobs

THIN_JOB = "mission-thin"
"""Kind of the job that thins by the rules of the settings."""

LIVE = timedelta(days=1)
"""Time after its last change during which a mission that has not ended counts as under way."""

_BLOCK = 20_000

Write = Callable[[], AbstractContextManager[Session]]


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule for thinning tracks."""

    # Maximum distance of a removed pose from the motion through the kept ones, metres; None: keep only the
    # first and the last.
    to_m: float | None
    after: timedelta = timedelta(0)  # Time after its last change at which a mission is due


@dataclass(frozen=True, slots=True)
class ThinnedTrack:
    """A track with the numbers of its poses before and after thinning."""

    mission: int
    source: str
    name: str
    before: int
    after: int


def rules(settings: MissionSettings) -> list[Rule]:
    """Return the rules of the settings, the one that removes most poses first."""
    found = []
    if settings.prune_after_days:
        found.append(Rule(None, timedelta(days=settings.prune_after_days)))
    if settings.thin_after_days:
        found.append(Rule(settings.thin_to_m, timedelta(days=settings.thin_after_days)))
    return found


def due(session: Session, rule: Rule) -> list[int]:
    """List the missions that have tracks to thin by a rule.

    Missions that are marked to be kept, in the bin, or still under way are left out.
    """
    over = or_(Mission.ended_at.is_not(None), Mission.changed_at < now() - LIVE)
    old = (Mission.changed_at <= now() - rule.after, over, ~Mission.keep, Mission.binned_at.is_(None))
    due_tracks = or_(_is_due(rule), tracks.has_removed())
    found = select(Mission.id).where(*old, Mission.id.in_(select(Track.mission_id).where(due_tracks)))
    return list(session.scalars(found.order_by(Mission.id)))


def too_recent(session: Session, ids: Sequence[int], *, rule: Rule) -> list[int]:
    """List those of some missions that changed too recently for a rule."""
    found = select(Mission.id).where(Mission.id.in_(ids), Mission.changed_at > now() - rule.after)
    return list(session.scalars(found.order_by(Mission.id)))


def sweep(library: Library, settings: Settings) -> None:
    """Queue the job that thins by the rules of the settings, if any mission is due."""
    wanted = rules(settings.missions)
    if not wanted:
        return
    with library.database.read() as session:
        if not any(due(session, rule) for rule in wanted):
            return
    with library.database.write() as session:
        jobs.enqueue(session, THIN_JOB)


def thin_mission(
    library: Library, id: int, *, rule: Rule, write: Write, progress: Progress, dry_run: bool = False
) -> Iterator[ThinnedTrack]:
    """Thin the tracks of a mission, one after the other.

    Args:
        write: Opens a write transaction.
        progress: Checked for cancellation before each track.
        dry_run: Only report what would be done.

    Yields:
        Each track that has lost poses.

    Raises:
        NotFound: The mission does not exist.
        Conflict: The mission is marked to be kept, in the bin, under way, or being changed.
        Cancelled
    """
    with library.database.read() as session:
        check(session, id)
        found = [track.id for track in tracks.list_tracks(session, id)]
    for track_id in found:
        progress.check()
        thinned = _thin(library, id, track_id, rule=rule, write=None if dry_run else write)
        if not dry_run:
            _delete_removed(library, track_id, write=write, progress=progress)
        if thinned is not None and thinned.after < thinned.before:
            yield thinned


def check(session: Session, id: int) -> Mission:
    """Find a mission whose tracks may be thinned. Raises NotFound, Conflict."""
    mission, where = session.get(Mission, id), f"mission {id}"
    if mission is None:
        raise NotFound("mission not found", where=where, hint="see: expmap mission list")
    if mission.keep:
        raise Conflict(
            "the mission is marked to be kept as it is",
            where=where,
            hint=f"remove the mark: expmap mission keep {id} --off",
        )
    if mission.binned_at is not None:
        raise Conflict("the mission is in the bin", where=where, hint="restore it first")
    if mission.ended_at is None and mission.changed_at >= now() - LIVE:
        raise Conflict(
            "the mission may still be under way",
            where=where,
            hint="wait until it has ended, or has not changed for a day",
        )
    return mission


def _is_due(rule: Rule) -> ColumnElement[bool]:
    if rule.to_m is None:
        return Track.poses > 2
    fresh = Track.thinned_poses < Track.poses
    return (Track.poses > 2) & or_(fresh, Track.thinned_m < rule.to_m)


def _thin(
    library: Library, mission_id: int, track_id: int, *, rule: Rule, write: Write | None
) -> ThinnedTrack | None:
    with library.database.read() as session:
        revision = session.get_one(Mission, mission_id).revision
        track = session.scalars(select(Track).where(Track.id == track_id, _is_due(rule))).first()
        if track is None:
            return None
        thinned_m, left = _left(session, track, rule)
    result = ThinnedTrack(mission_id, track.source, track.name, track.poses, len(left))
    if write is None:
        return result
    with write() as session:
        mission = session.get_one(Mission, mission_id, with_for_update=True)
        if check(session, mission_id).revision != revision:
            raise Conflict("the mission is being changed", where=f"mission {mission_id}")
        tracks.thin(session, session.get_one(Track, track_id), left, thinned_m=thinned_m)
        mission.revision += 1  # but keep `changed_at`, from which the age of a mission counts
    return result


def _delete_removed(library: Library, track_id: int, *, write: Write, progress: Progress) -> None:
    left = select(Track.id).where(Track.id == track_id, tracks.has_removed())
    while True:
        with library.database.read() as session:
            if session.scalar(left) is None:
                return
        with write() as session:
            tracks.delete_removed(session, track_id)
        progress.check()


def _left(session: Session, track: Track, rule: Rule) -> tuple[float | None, Poses]:
    """Return the maximum error of the thinned track, and the poses to keep.

    Where poses were thinned before, both errors add up, so only the rest of the tolerance is used. There the
    original sampling interval is unknown, so every interval above `GAP_S` counts as a gap.
    """
    if rule.to_m is None:
        return None, tracks.at(session, track, [0, track.poses - 1])
    before_m = track.thinned_m if track.thinned_poses else 0.0
    more_m = 0.0 if before_m is None else max(rule.to_m - before_m, 0.0)
    left, old = [], track.thinned_poses
    for tolerance_m, gap_s, first, stop in (more_m, GAP_S, 0, old), (rule.to_m, None, old, track.poses):
        for begin in range(first, stop, _BLOCK):
            poses = tracks.read(session, track, first=begin, stop=min(begin + _BLOCK, stop))
            left.append(_thinned(poses, tolerance_m, gap_s) if tolerance_m else poses)
    return None if before_m is None else max(rule.to_m, before_m), join(left)


def _thinned(poses: Poses, tolerance_m: float, gap_s: float | None) -> Poses:
    chosen = simplify_motion(
        poses.times_s, poses.latlon, height_m=poses.height_m, tolerance_m=tolerance_m, gap_s=gap_s
    )
    return poses.take(np.flatnonzero(chosen))
