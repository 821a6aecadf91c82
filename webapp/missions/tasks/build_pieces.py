"""Prepares the tracks of a mission for display: simplified at several levels, and with their profile.

Only whole chunks of poses are prepared, so that nothing is ever prepared twice; the poses after them are read
as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from webapp.core.trajectory.distance import profile
from webapp.core.trajectory.records import Poses
from webapp.core.trajectory.simplify import simplified
from webapp.missions.store import track_pieces, tracks
from webapp.missions.store.schema import Track
from webapp.missions.store.tracks import PIECE
from webapp.progress import Progress
from webapp.store.library import Library

LEVELS = 8
FINEST_M = 0.5
_COARSER = 4
"""The next level has so many times the tolerance, and its chunks so many times the poses."""

_PROFILE_POINTS = 64
"""Of one chunk."""

Write = Callable[[], AbstractContextManager[Session]]


def tolerance_of(level: int) -> float:
    """Return how far from the line a pose may lie that a level leaves out, metres."""
    return FINEST_M * float(_COARSER**level)


def build_pieces(library: Library, mission_id: int, *, write: Write, progress: Progress) -> int:
    """Prepare what is new, a transaction each chunk: others write in between.

    Parameters
    ----------
    write : callable
        Gives a session that writes.
    progress : Progress
        One step a chunk.

    Returns
    -------
    int
        Chunks that were prepared.

    Raises
    ------
    Cancelled
    """
    with library.database.read() as session:
        found = tracks.listed(session, mission_id)
    progress.size(sum((track.poses - track.built_to) // PIECE for track in found))
    built = 0
    for track in found:
        while _build_next(track.id, write):
            built += 1
            progress.advance()
            progress.check()
    return built


def _build_next(track_id: int, write: Write) -> bool:
    """Prepare the next chunk of a track; False when there is no whole one."""
    with write() as session:
        track = session.get(Track, track_id, with_for_update=True)
        if track is None or track.poses - track.built_to < PIECE:
            return False
        chunk = track.built_to // PIECE
        poses = tracks.read(session, track, first=track.built_to, stop=track.built_to + PIECE)
        points = table_of(poses, first=track.built_to)
        points = points[simplified(points[:, 2:4], FINEST_M)]
        track_pieces.add(session, track, level=0, chunk=chunk, count=PIECE, points=points)
        samples = profile(poses.times_s, poses.travelled_m, height_m=poses.height_m, points=_PROFILE_POINTS)
        track_pieces.add_profile(session, track, chunk=chunk, points=samples)
        _build_coarser(session, track, chunk)
        track.built_to += PIECE
    return True


def _build_coarser(session: Session, track: Track, chunk: int) -> None:
    """Join pieces of a level to one of the next, as far up as this chunk completes some."""
    for level in range(1, LEVELS):
        chunk, place = divmod(chunk, _COARSER)
        if place != _COARSER - 1:
            return
        session.flush()
        below = range(chunk * _COARSER, (chunk + 1) * _COARSER)
        points = np.concatenate(track_pieces.points(session, track, level=level - 1, chunks=below))
        # What the level below has left out lies within its tolerance: together it is that of this level.
        points = points[simplified(points[:, 2:4], tolerance_of(level) - tolerance_of(level - 1))]
        track_pieces.add(
            session, track, level=level, chunk=chunk, count=PIECE * _COARSER**level, points=points
        )


def table_of(poses: Poses, *, first: int) -> NDArray[np.float64]:
    """Give poses as points, (n, 5) float64: number, time_s, lat, lon, heading_deg."""
    numbers = np.arange(first, first + len(poses), dtype=np.float64)
    return np.column_stack([numbers, poses.times_s, poses.latlon, poses.heading_deg])
