"""Parts of tracks that are prepared for display, each as a table of numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.core.trajectory.distance import COLUMNS
from webapp.missions.store.schema import Track, TrackPiece, TrackProfile

POINT = 5
"""Numbers of a point: number, time_s, lat, lon, heading_deg."""

_FLOAT64 = np.dtype("<f8")
_MOST_PARAMETERS = 500


@dataclass(frozen=True, slots=True)
class Piece:
    """What is known of a piece without its points.

    Attributes
    ----------
    bounds : (float, float, float, float)
        South, west, north, east, degrees.
    """

    chunk: int
    first_number: int
    count: int
    points: int
    bounds: tuple[float, float, float, float]


def add(
    session: Session, track: Track, *, level: int, chunk: int, count: int, points: NDArray[np.float64]
) -> None:
    """Keep a piece of a track.

    Parameters
    ----------
    count : int
        Poses that it stands for.
    points : (m, 5) float64
    """
    south, west = points[:, 2:4].min(axis=0).tolist()
    north, east = points[:, 2:4].max(axis=0).tolist()
    session.add(
        TrackPiece(
            track_id=track.id,
            level=level,
            chunk=chunk,
            first_number=chunk * count,
            count=count,
            min_lat=south,
            max_lat=north,
            min_lon=west,
            max_lon=east,
            first_time_s=float(points[:, 1].min()),
            last_time_s=float(points[:, 1].max()),
            points=points.astype(_FLOAT64).tobytes(),
        )
    )


def add_profile(session: Session, track: Track, *, chunk: int, points: NDArray[np.float64]) -> None:
    """Keep the profile of a chunk, (m, 4) float64."""
    session.add(TrackProfile(track_id=track.id, chunk=chunk, points=points.astype(_FLOAT64).tobytes()))


def listed(session: Session, track: Track, *, level: int) -> list[Piece]:
    """List the pieces of a level, in the order of the track."""
    size = func.length(TrackPiece.points)
    sides = (TrackPiece.min_lat, TrackPiece.min_lon, TrackPiece.max_lat, TrackPiece.max_lon)
    found = select(TrackPiece.chunk, TrackPiece.first_number, TrackPiece.count, size, *sides)
    mine = found.where(TrackPiece.track_id == track.id, TrackPiece.level == level)
    width = POINT * _FLOAT64.itemsize
    return [
        Piece(chunk, first, count, length // width, (south, west, north, east))
        for chunk, first, count, length, south, west, north, east in session.execute(
            mine.order_by(TrackPiece.chunk)
        )
    ]


def points(session: Session, track: Track, *, level: int, chunks: Sequence[int]) -> list[NDArray[np.float64]]:
    """Read the points of some pieces of a level, (m, 5) float64 each, in the order of the track."""
    found: list[NDArray[np.float64]] = []
    for begin in range(0, len(chunks), _MOST_PARAMETERS):
        some = TrackPiece.chunk.in_(chunks[begin : begin + _MOST_PARAMETERS])
        mine = select(TrackPiece.points).where(
            TrackPiece.track_id == track.id, TrackPiece.level == level, some
        )
        found += [_table(data, POINT) for data in session.scalars(mine.order_by(TrackPiece.chunk))]
    return found


def profiles(session: Session, track: Track) -> NDArray[np.float64]:
    """Read the profile of all chunks, (m, 4) float64."""
    found = select(TrackProfile.points).where(TrackProfile.track_id == track.id).order_by(TrackProfile.chunk)
    return np.concatenate(
        [np.empty((0, COLUMNS)), *(_table(data, COLUMNS) for data in session.scalars(found))]
    )


def _table(data: bytes, columns: int) -> NDArray[np.float64]:
    return np.frombuffer(data, _FLOAT64).reshape(-1, columns).astype(np.float64)
