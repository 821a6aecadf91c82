"""Tracks of a mission for display, as a line and as a profile of a few thousand points at most.

For long tracks a job builds pieces, simplified at several levels, and profiles, from whole chunks of poses
only, so that none is built twice. Poses after the last chunk are read directly.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from webapp.missions.core.trajectory.distance import profile
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.core.trajectory.thinning import simplify
from webapp.missions.store import tracks
from webapp.missions.store.schema import Track
from webapp.missions.store.tracks import PIECE, POINT, Piece
from webapp.progress import Progress
from webapp.store.library import Library

LEVELS = 8
FINEST_M = 0.5
_COARSER = 4
"""Factor of the tolerance from level to level, and of the number of poses in a chunk."""

_PROFILE_POINTS = 64
"""Points of the profile of one chunk."""

Write = Callable[[], AbstractContextManager[Session]]

MOST = 5000
"""Maximum number of points of a line."""

AS_IT_IS = -1
"""The level of poses that are not simplified."""

_MOST_TAIL = 20_000
"""If more poses than this are not in pieces yet, only some of them are read."""

_DIRECT = 40_000
"""Maximum number of poses that are read directly for a profile; otherwise the prepared profile is used."""


def tolerance_of(level: int) -> float:
    """Return the maximum distance from the line of poses that a level leaves out, metres."""
    return FINEST_M * float(_COARSER**level)


def build_pieces(library: Library, mission_id: int, *, write: Write, progress: Progress) -> int:
    """Build the pieces of new poses, one transaction per chunk, so that others can write in between.

    Raises Cancelled.

    Args:
        write: Opens a write transaction.
        progress: One step per chunk.

    Returns:
        Number of chunks that were built.
    """
    with library.database.read() as session:
        found = tracks.list_tracks(session, mission_id)
    progress.size(sum((track.poses - track.built_to) // PIECE for track in found))
    built = 0
    for track in found:
        while _build_next(track.id, write):
            built += 1
            progress.advance()
            progress.check()
    return built


def _build_next(track_id: int, write: Write) -> bool:
    """Build the next chunk of a track; return False if it is not complete yet."""
    with write() as session:
        track = session.get(Track, track_id, with_for_update=True)
        if track is None or track.poses - track.built_to < PIECE:
            return False
        chunk = track.built_to // PIECE
        poses = tracks.read(session, track, first=track.built_to, stop=track.built_to + PIECE)
        points = table_of(poses, first=track.built_to)
        points = points[simplify(points[:, 2:4], FINEST_M)]
        tracks.add_piece(session, track, level=0, chunk=chunk, count=PIECE, points=points)
        samples = profile(poses.times_s, poses.travelled_m, height_m=poses.height_m, points=_PROFILE_POINTS)
        tracks.add_profile(session, track, chunk=chunk, points=samples)
        _build_coarser(session, track, chunk)
        track.built_to += PIECE
    return True


def _build_coarser(session: Session, track: Track, chunk: int) -> None:
    """Merge pieces into one of the next coarser level, for each level that this chunk completes."""
    for level in range(1, LEVELS):
        chunk, place = divmod(chunk, _COARSER)
        if place != _COARSER - 1:
            return
        session.flush()
        below = range(chunk * _COARSER, (chunk + 1) * _COARSER)
        points = np.concatenate(tracks.piece_points(session, track, level=level - 1, chunks=below))
        # The error of the level below counts too: together they stay within the tolerance of this level.
        points = points[simplify(points[:, 2:4], tolerance_of(level) - tolerance_of(level - 1))]
        tracks.add_piece(
            session, track, level=level, chunk=chunk, count=PIECE * _COARSER**level, points=points
        )


def table_of(poses: Poses, *, first: int) -> NDArray[np.float64]:
    """Return poses as points, (n, 5) float64: number, time_s, lat, lon, heading_deg."""
    numbers = np.arange(first, first + len(poses), dtype=np.float64)
    return np.column_stack([numbers, poses.times_s, poses.latlon, poses.heading_deg])


@dataclass(frozen=True, slots=True)
class LineView:
    """The requested part of a track, and its resolution."""

    tolerance_m: float = 0.0  # Maximum distance of a pose from the line
    # South, west, north, east, degrees, to clip the line; if west > east, across the 180th meridian.
    box: tuple[float, float, float, float] | None = None
    since: int = -1  # Only poses with greater numbers


@dataclass(frozen=True, slots=True)
class TrackLine:
    level: int  # Level of simplification; -1: none
    points: NDArray[np.float64]  # (n, 5) float64. number, time_s, lat, lon, heading_deg.
    # (m,) intp. Indices of points that are not connected with the previous one: the track leaves the box in
    # between.
    gaps: NDArray[np.intp]
    complete: bool  # Whether it has the requested resolution


def track_line(session: Session, track: Track, view: LineView) -> TrackLine:
    """Read the line of a track."""
    wanted = _level_of(view.tolerance_m)
    tail, all_read = _tail(session, track, view)
    level = wanted
    while True:
        pieces = _chosen(session, track, level=level, view=view)
        size = sum(_size(piece, level) for _, piece in pieces)
        if size <= MOST or level == LEVELS - 1:
            break
        level += 1
    points, joined = _read(session, track, pieces, tail=tail, as_it_is=level == AS_IT_IS)
    if level != AS_IT_IS:
        begin = len(points) - len(tail)
        keep = np.ones(len(points), dtype=np.bool_)
        keep[begin:] = simplify(tail[:, 2:4], tolerance_of(level))
        points, joined = points[keep], joined[keep]
    points, gaps = _inside(points, joined, view)
    points, gaps, coarser = _thinned(points, gaps, tolerance_of(max(level, 0)))
    return TrackLine(level, points, gaps, complete=level == wanted and all_read and not coarser)


def _level_of(tolerance_m: float) -> int:
    return max((k for k in range(LEVELS) if tolerance_of(k) <= tolerance_m), default=AS_IT_IS)


def _tail(session: Session, track: Track, view: LineView) -> tuple[NDArray[np.float64], bool]:
    """Read the poses that are not in pieces; return also whether these are all of them."""
    first = max(track.built_to, view.since + 1)
    count = track.poses - first
    if count <= 0:
        return np.empty((0, POINT)), True
    if count <= _MOST_TAIL:
        return table_of(tracks.read(session, track, first=first), first=first), True
    numbers = np.linspace(first, track.poses - 1, MOST).astype(np.int64)
    points = table_of(tracks.at(session, track, numbers.tolist()), first=0)
    points[:, 0] = numbers
    return points, False


def _chosen(session: Session, track: Track, *, level: int, view: LineView) -> list[tuple[int, Piece]]:
    """List the visible pieces of a level, and finer ones where that level is not built yet."""
    found: list[tuple[int, Piece]] = []
    covered = 0
    for below in range(max(level, 0), -1, -1):
        pieces = [p for p in tracks.list_pieces(session, track, level=below) if p.first_number >= covered]
        if pieces:
            covered = pieces[-1].first_number + pieces[-1].count
        found += [(below, piece) for piece in pieces if _is_seen(piece, view)]
    return found


def _size(piece: Piece, level: int) -> int:
    return piece.count if level == AS_IT_IS else piece.points


def _is_seen(piece: Piece, view: LineView) -> bool:
    if piece.first_number + piece.count <= view.since + 1:
        return False
    if view.box is None:
        return True
    south, west, north, east = piece.bounds
    low, left, high, right = view.box
    outside = east < left or west > right if left <= right else west > right and east < left
    return not (north < low or south > high or outside)


def _read(
    session: Session,
    track: Track,
    pieces: list[tuple[int, Piece]],
    *,
    tail: NDArray[np.float64],
    as_it_is: bool,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Read the points of pieces; return also for each whether it is connected with the previous one."""
    tables = _poses(session, track, pieces) if as_it_is else _points(session, track, pieces)
    points = np.concatenate([*tables, tail])
    joined = np.ones(len(points), dtype=np.bool_)
    ends = [piece.first_number + piece.count for _, piece in pieces]
    begins = [*(piece.first_number for _, piece in pieces[1:]), *([track.built_to] if len(tail) else [])]
    places = np.cumsum([len(table) for table in tables])
    for place, end, begin in zip(places, ends, begins, strict=False):
        joined[place] = end == begin
    return points, joined


def _points(session: Session, track: Track, pieces: list[tuple[int, Piece]]) -> list[NDArray[np.float64]]:
    tables: list[NDArray[np.float64]] = []
    for level in sorted({level for level, _ in pieces}, reverse=True):
        chunks = [piece.chunk for own, piece in pieces if own == level]
        tables += tracks.piece_points(session, track, level=level, chunks=chunks)
    return tables


def _poses(session: Session, track: Track, pieces: list[tuple[int, Piece]]) -> list[NDArray[np.float64]]:
    return [
        table_of(
            tracks.read(session, track, first=piece.first_number, stop=piece.first_number + piece.count),
            first=piece.first_number,
        )
        for _, piece in pieces
    ]


def _inside(
    points: NDArray[np.float64], joined: NDArray[np.bool_], view: LineView
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Keep the end points of all segments that touch the requested part; return them with the gaps."""
    joined = joined & (np.arange(len(points)) > 0)
    new = points[:, 0] > view.since
    seen = new & joined & np.roll(new, 1)
    alone = new.copy()
    if view.box is not None and len(points):
        seen &= _touches(np.roll(points[:, 2:4], 1, axis=0), points[:, 2:4], view.box)
        alone &= _touches(points[:, 2:4], points[:, 2:4], view.box)
    kept = np.flatnonzero(seen | np.append(seen[1:], False) | alone)
    follows = np.diff(kept, prepend=-2) == 1
    gaps = np.flatnonzero(~(follows & seen[kept]))
    return points[kept], gaps[gaps > 0]


def _touches(
    a: NDArray[np.float64], b: NDArray[np.float64], box: tuple[float, float, float, float]
) -> NDArray[np.bool_]:
    """Return for segments from a to b whether their bounding boxes intersect a box."""
    south, west, north, east = box
    low, high = np.minimum(a, b), np.maximum(a, b)
    outside = (high[:, 1] < west) | (low[:, 1] > east)
    if west > east:
        outside = (low[:, 1] > east) & (high[:, 1] < west)
    return np.asarray(~((high[:, 0] < south) | (low[:, 0] > north) | outside))


def _thinned(
    points: NDArray[np.float64], gaps: NDArray[np.intp], tolerance_m: float
) -> tuple[NDArray[np.float64], NDArray[np.intp], bool]:
    """Simplify the line further if it has too many points; return also whether that was done."""
    tolerance = max(tolerance_m, FINEST_M)
    coarser = False
    while len(points) > MOST:
        coarser = True
        keep = simplify(points[:, 2:4], tolerance)
        keep[gaps] = keep[gaps - 1] = True
        if keep.all() or len(gaps) * 2 >= MOST:
            step = -(-len(points) // MOST)
            return points[::step], np.unique(gaps // step), coarser
        gaps = np.cumsum(keep)[gaps] - 1
        points = points[keep]
        tolerance *= 2
    return points, gaps, coarser


def track_profile(session: Session, track: Track, *, points: int) -> NDArray[np.float64]:
    """Read the profile of a track.

    Args:
        points: Maximum number of points.

    Returns:
        (n, 4) float64: time_s, travelled_m, speed_mps, height_m; NaN where unknown.
    """
    table = np.empty((0, 4)) if track.poses <= _DIRECT else tracks.profiles(session, track)
    first = track.built_to if len(table) else 0
    if track.poses - first <= _DIRECT:
        tail = tracks.read(session, track, first=first)
    else:
        numbers = np.unique(np.linspace(first, track.poses - 1, points).astype(np.int64))
        tail = tracks.at(session, track, numbers.tolist())
    return profile(
        np.concatenate([table[:, 0], tail.times_s]),
        np.concatenate([table[:, 1], tail.travelled_m]),
        height_m=np.concatenate([table[:, 3], tail.height_m]),
        points=points,
    )
