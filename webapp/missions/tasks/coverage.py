"""How much of each search area of a mission its tracks have covered.

Corrected and GPS tracks count; odometry, which drifts, only in a mission without them, and visual fixes and
manual positions, of which each covers its own surroundings only, if there is nothing else.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from sqlalchemy.orm import Session

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.errors import Busy
from webapp.missions.core.coverage import Coverage, joined_by_time
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.store import drawings, tracks
from webapp.missions.store.schema import MissionDrawing, Track
from webapp.missions.tasks.track_display import tolerance_of
from webapp.store.library import Library

_SOURCES = (("fused", "gps"), ("odometry",), ("visual", "manual"))
_UNJOINED = {"visual", "manual"}
_BLOCK = 20_000
_BEFORE = 64
"""Poses before new ones that are read again, to know the usual interval."""

_KEPT = 4096
"""Areas whose share is in memory."""

_SAMPLES = 64_000_000
"""Samples, 16 MB, of the areas whose grid is in memory, too, so that new poses can be added to it."""

_AT_ONCE = 256
"""Poses between two looks at the clock: of the longest ways across the finest grid, a few seconds' work."""

_BUDGET_S = 5.0
_WAIT_S = 2

_Counted = dict[int, tuple[object, int]]
"""Marks, and number of poses that were counted, by the id of the track."""


@dataclass(frozen=True, slots=True)
class AreaCoverage:
    """How much of an area was covered."""

    id: int  # Of the drawing
    share: float | None  # 0 to 1; None for an area too narrow to be measured
    tracks: tuple[int, ...]  # Ids of the tracks that count
    # False if poses of these tracks were removed by thinning: what was covered is then not known exactly.
    exact: bool


@dataclass(frozen=True, slots=True)
class TrackSearch:
    """What one track has covered of an area."""

    track: int  # Its id
    share: float  # 0 to 1
    first_time_s: float | None  # When it was first and last within the radius of the area; None if unknown
    last_time_s: float | None


@dataclass(frozen=True, slots=True)
class AreaSearch:
    """How much of an area was covered, and by which tracks."""

    coverage: AreaCoverage
    by: tuple[TrackSearch, ...]  # Those that have covered some of it


@dataclass(slots=True)
class _Kept:
    """The covered part of an area, and what it was computed from."""

    frame: LocalFrame
    coverage: Coverage | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    counted: _Counted | None = None
    share: float | None = None


class _Budget:
    """The time that a request may take."""

    def __init__(self, seconds: float) -> None:
        self._until = time.monotonic() + seconds
        self._begun = False

    def check(self) -> None:
        """Raise Busy when the time is over; not at the first call, so that each request gets on."""
        if self._begun and time.monotonic() > self._until:
            raise Busy(
                "what the tracks have covered is still being computed",
                wait_s=_WAIT_S,
                hint="ask again: the server goes on where it stopped",
            )
        self._begun = True


class CoverageCache:
    """The coverage of areas last asked for; it depends on their shape, the radius, and the poses only."""

    def __init__(self, *, samples: int = _SAMPLES, budget_s: float = _BUDGET_S) -> None:
        self._samples = samples
        self._budget_s = budget_s
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[object, ...], _Kept] = OrderedDict()

    def of_mission(self, library: Library, mission_id: int) -> list[AreaCoverage]:
        """Compute the coverage of each area of a mission, in order of creation.

        Raises:
            Busy: It takes longer than the budget; the next call goes on where this one ended.
        """
        budget = _Budget(self._budget_s)
        with library.database.read() as session:
            found = counting_tracks(tracks.list_tracks(session, mission_id))
            areas = [row for row in drawings.list_drawings(session, mission_id) if row.kind == "area"]
            ids = tuple(track.id for track in found)
            exact = not any(track.removed for track in found)
            return [
                AreaCoverage(
                    row.id, self._share(session, row, found, at=library.folder, budget=budget), ids, exact
                )
                for row in areas
            ]

    def _share(
        self, session: Session, row: MissionDrawing, found: list[Track], *, at: object, budget: _Budget
    ) -> float | None:
        kept = self._entry((at, row.mission_id, row.points, row.radius_m), row)
        with kept.lock:
            coverage, counted = kept.coverage, kept.counted
            if counted is not None and not _has_grown(counted, found):
                counted = None
            if counted is not None and not _new(counted, found):
                return kept.share
            if counted is None or coverage is None:
                budget.check()
                coverage, counted = _laid(kept, row), {}
            kept.coverage, kept.counted = coverage, counted
            for number, track in enumerate(_new(counted, found)):
                if number:
                    budget.check()
                first = counted.get(track.id, (None, 0))[1]
                for done in _add(session, coverage, track, frame=kept.frame, first=first):
                    counted[track.id] = (_marks(track), done)
                    if done < track.poses:
                        budget.check()
                counted[track.id] = (_marks(track), track.poses)
            kept.share = coverage.share
        self._release()
        return kept.share

    def _entry(self, key: tuple[object, ...], row: MissionDrawing) -> _Kept:
        with self._lock:
            kept = self._kept.get(key)
            if kept is None:
                kept = self._kept[key] = _Kept(LocalFrame(centre_of(drawings.points_of(row))))
            self._kept.move_to_end(key)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return kept

    def _release(self) -> None:
        """Release the grids of the areas least recently asked for; their shares stay."""
        left = self._samples
        with self._lock:
            for kept in reversed(self._kept.values()):
                if kept.coverage is not None:
                    left -= kept.coverage.samples
                    if left < 0:
                        kept.coverage = None


def search_areas(library: Library, mission_id: int, *, budget_s: float) -> dict[int, AreaSearch]:
    """Compute who has covered how much of each area of a mission, by the id of the area.

    Areas for which the time does not suffice are left out.
    """
    budget, done = _Budget(budget_s), dict[int, AreaSearch]()
    with library.database.read() as session:
        found = counting_tracks(tracks.list_tracks(session, mission_id))
        for row in drawings.list_drawings(session, mission_id):
            if row.kind == "area":
                try:
                    done[row.id] = _searched(session, row, found, budget=budget)
                except Busy:
                    break
    return done


def _searched(session: Session, row: MissionDrawing, found: list[Track], *, budget: _Budget) -> AreaSearch:
    kept = _Kept(LocalFrame(centre_of(drawings.points_of(row))))
    total, by = _laid(kept, row), list[TrackSearch]()
    for track in found:
        budget.check()
        own = total.empty()
        for _ in _add(session, own, track, frame=kept.frame, first=0):
            budget.check()
        total.include(own)
        if own.share:
            times = _times_near(session, own, track, frame=kept.frame) if track.timed else (None, None)
            by.append(TrackSearch(track.id, own.share, *times))
    ids, exact = tuple(track.id for track in found), not any(track.removed for track in found)
    return AreaSearch(AreaCoverage(row.id, total.share, ids, exact), tuple(by))


def _times_near(
    session: Session, coverage: Coverage, track: Track, *, frame: LocalFrame
) -> tuple[float | None, float | None]:
    """Return the first and the last time of the poses near the area; None if only ways pass it."""
    first, last = [], []
    for poses, _ in _parts(session, coverage, track, frame=frame, first=0):
        times = poses.times_s[coverage.is_near(frame.enu_from_latlon(poses.latlon))]
        if len(times):
            first.append(float(times.min()))
            last.append(float(times.max()))
    return min(first, default=None), max(last, default=None)


def _laid(kept: _Kept, row: MissionDrawing) -> Coverage:
    assert row.radius_m is not None, "areas have a radius"
    return Coverage(kept.frame.enu_from_latlon(drawings.points_of(row)), row.radius_m)


def counting_tracks(found: Sequence[Track]) -> list[Track]:
    """Return the tracks that count for the coverage of a mission."""
    for sources in _SOURCES:
        some = [track for track in found if track.source in sources and track.poses]
        if some:
            return some
    return []


def _marks(track: Track) -> object:
    """Return values that change if poses of a track were replaced, not only appended."""
    rewritten = (track.poses, track.distance_m, track.last_time_s) if track.source == "fused" else None
    return track.removed, track.thinned_poses, track.timed, rewritten


def _has_grown(counted: _Counted, found: Sequence[Track]) -> bool:
    """Return whether at most new tracks and new poses were added."""
    now = {track.id: track for track in found}
    return all(
        id in now and marks == _marks(now[id]) and count <= now[id].poses
        for id, (marks, count) in counted.items()
    )


def _new(counted: _Counted, found: Sequence[Track]) -> list[Track]:
    return [track for track in found if counted.get(track.id, (None, -1))[1] != track.poses]


def _add(
    session: Session, coverage: Coverage, track: Track, *, frame: LocalFrame, first: int
) -> Iterator[int]:
    """Add the poses of a track from a number on; yields now and then how many of the track were counted."""
    for poses, number in _parts(session, coverage, track, frame=frame, first=first):
        if track.source in _UNJOINED or (track.removed and track.thinned_m is None):
            joined = np.zeros(max(len(poses) - 1, 0), dtype=np.bool_)
        elif not track.timed:
            joined = np.ones(max(len(poses) - 1, 0), dtype=np.bool_)
        else:
            joined = joined_by_time(poses.times_s)
            # where poses were left out on purpose, the intervals say nothing
            joined |= np.arange(number + 1, number + len(poses)) < track.thinned_poses
        metres = frame.enu_from_latlon(poses.latlon)
        for begin in range(0, len(poses), _AT_ONCE):
            end = begin + _AT_ONCE
            coverage.add(metres[begin : end + 1], joined[begin:end])
            yield max(first, min(number + end, track.poses))


def _parts(
    session: Session, coverage: Coverage, track: Track, *, frame: LocalFrame, first: int
) -> Iterator[tuple[Poses, int]]:
    """Yield poses that may be near the area, each part with its first number, and some before it."""
    pieces = [one for one in tracks.list_pieces(session, track, level=0) if one.first_number >= first]
    end = first
    for piece in pieces:
        begin, end = piece.first_number, piece.first_number + piece.count
        if begin == pieces[0].first_number and begin > first:
            yield _read(session, track, first, end=begin)
        if _is_near(coverage, piece.bounds, frame=frame):
            yield _read(session, track, begin, end=end)
    for begin in range(end, track.poses, _BLOCK):
        yield _read(session, track, begin, end=begin + _BLOCK)


def _read(session: Session, track: Track, begin: int, *, end: int) -> tuple[Poses, int]:
    begin = max(begin - _BEFORE, 0)
    return tracks.read(session, track, first=begin, stop=end + 1), begin


def _is_near(coverage: Coverage, bounds: tuple[float, float, float, float], *, frame: LocalFrame) -> bool:
    south, west, north, east = bounds
    if east - west > 180.0:
        return True
    corners = frame.enu_from_latlon([(south, west), (south, east), (north, west), (north, east)])
    pad = coverage.radius_m + tolerance_of(0) + 1.0
    low, high = coverage.outline.min(axis=0) - pad, coverage.outline.max(axis=0) + pad
    far = float(np.abs(corners).max()) > 1e6  # the plane bends far away: look at the poses
    return far or bool((corners.min(axis=0) <= high).all() and (corners.max(axis=0) >= low).all())
