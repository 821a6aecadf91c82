"""Tracks of missions: their poses, read and written by columns, and the pieces built for display."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Select, and_, delete, exists, func, select
from sqlalchemy.orm import Session

from webapp.core import texts
from webapp.errors import NotFound, UsageError
from webapp.missions.core.looks import MAX_TITLE, TrackLook
from webapp.missions.core.trajectory.distance import COLUMNS, fill_travelled
from webapp.missions.core.trajectory.records import Poses, join, make_poses
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, Pose, Track, TrackPiece, TrackProfile
from webapp.store.database import backend_of
from webapp.store.operate import jobs

_COLUMNS = tuple(column.name for column in Pose.__table__.columns)
_READ = tuple(column for column in Pose.__table__.columns if column.name != "track_id")
_BLOCK = 20_000
_MOST_PARAMETERS = 500

PIECES_JOB = "mission-pieces"
PIECE = 4096
"""Poses of the smallest piece; as many new poses start a job that builds pieces."""

POINT = 5
"""Values per point: number, time_s, lat, lon, heading_deg."""

_BEST_FIRST = ("fused", "gps", "odometry", "visual", "manual")
_FLOAT64 = np.dtype("<f8")


def list_tracks(session: Session, mission_id: int) -> list[Track]:
    """List the tracks of a mission in order of creation."""
    return list(session.scalars(select(Track).where(Track.mission_id == mission_id).order_by(Track.id)))


def best(found: Sequence[Track]) -> Track | None:
    """Return the track from the most accurate source; None if there are no tracks."""
    return min(found, key=lambda track: _BEST_FIRST.index(track.source), default=None)


def find(session: Session, mission_id: int, track_id: int) -> Track:
    """Find a track of a mission. Raises NotFound."""
    track = session.get(Track, track_id)
    if track is None or track.mission_id != mission_id:
        raise NotFound(f"the mission has no track {track_id}", hint="reload the page")
    return track


def get_or_create(session: Session, mission_id: int, *, source: str, name: str = "") -> Track:
    """Find the track of a source and name, or create it.

    Args:
        source: One of `webapp.missions.core.trajectory.records.SOURCES`.
        name: Distinguishes several tracks of one source.
    """
    same = (Track.mission_id == mission_id, Track.source == source, Track.name == name)
    track = session.scalars(select(Track).where(*same)).first()
    if track is None:
        track = Track(mission_id=mission_id, source=source, name=name)
        session.add(track)
        session.flush()
    return track


def look_of(track: Track) -> TrackLook:
    """Return how a track looks."""
    return TrackLook(**(track.look or {}))


def change_look(session: Session, mission: Mission, *, id: int, fields: Mapping[str, Any]) -> Track:
    """Change some fields of the look of a track; without a difference nothing happens.

    Args:
        fields: Some of those of `TrackLook`.

    Raises:
        NotFound: The mission does not have the track.
        UsageError: The title is invalid.
    """
    track = find(session, mission.id, id)
    look = replace(look_of(track), **fields)
    look = replace(look, title=_checked_title(look.title))
    if look != look_of(track):
        track.look = look.fields()
        missions.count_change(mission)
        track.look_revision = mission.revision
    return track


def _checked_title(title: str) -> str:
    tidy = texts.tidy_name(title, most=MAX_TITLE) if title.strip() else ""
    if tidy is None:
        raise UsageError(
            "this is not a valid name for a track",
            where="title",
            hint=f"give at most {MAX_TITLE} printable characters",
        )
    return tidy


def append(session: Session, track: Track, poses: Poses, *, skipped: int = 0) -> None:
    """Append poses to a track, and update its summary values.

    After `PIECE` new poses, the job that builds pieces for display is queued in the same session. The caller
    must call `missions.count_change` in the same session.

    Args:
        poses: Where `travelled_m` is NaN, it is measured from the previous pose.
        skipped: Number of poses that were left out between them.
    """
    track.skipped += skipped
    if not len(poses):
        return
    travelled = fill_travelled(poses.latlon, poses.travelled_m, before=_end(session, track))
    _insert(session, track, replace(poses, travelled_m=travelled))
    _count(track, poses, way_m=float(travelled[-1]))
    if track.poses - track.built_to >= PIECE:
        jobs.enqueue(session, PIECES_JOB, key=str(track.mission_id), arguments={"mission": track.mission_id})


def clear(session: Session, track: Track) -> None:
    """Delete all poses of a track."""
    session.execute(delete(Pose).where(Pose.track_id == track.id))
    _forget(session, track)


def _forget(session: Session, track: Track) -> None:
    """Reset a track to one without poses; their rows stay."""
    for table in (TrackPiece, TrackProfile):
        session.execute(delete(table).where(table.track_id == track.id))
    track.poses = track.skipped = track.built_to = track.removed = track.thinned_poses = 0
    track.thinned_m = None
    track.distance_m = 0.0
    track.first_time_s = track.last_time_s = None
    track.min_lat = track.max_lat = track.min_lon = track.max_lon = None


_OF_ALL = (
    "skipped", "removed", "distance_m", "first_time_s", "last_time_s",
    "min_lat", "max_lat", "min_lon", "max_lon",
)  # fmt: skip
"""Summary values over all poses of a track, including removed ones."""


def thin(session: Session, track: Track, poses: Poses, *, thinned_m: float | None) -> None:
    """Replace the poses of a track by some of them, keeping its summary values.

    The time depends only on the number of poses kept: surplus rows no longer count as poses, and are deleted
    later by `delete_removed`.

    Args:
        poses: Poses to keep, including the first and the last.
        thinned_m: Maximum distance of the removed poses from the motion through these; None if unknown.
    """
    removed = track.poses - len(poses)
    if removed:
        known = {name: getattr(track, name) for name in _OF_ALL}
        _forget(session, track)
        append(session, track, poses)
        for name, value in known.items():
            setattr(track, name, value)
        track.removed += removed
    track.thinned_m, track.thinned_poses = thinned_m, track.poses


def has_removed() -> ColumnElement[bool]:
    """Return a condition for queries on tracks: rows of removed poses are left."""
    return exists().where(Pose.track_id == Track.id, Pose.number >= Track.poses)


def delete_removed(session: Session, track_id: int) -> None:
    """Delete a block of rows of removed poses, starting with the last."""
    track = session.get(Track, track_id)
    last = session.scalar(select(func.max(Pose.number)).where(Pose.track_id == track_id))
    if track is not None and last is not None:
        first = max(track.poses, last + 1 - _BLOCK)
        session.connection().execute(delete(Pose).where(_are(track, first, last + 1)))


def inherit_thinning(track: Track, inputs: Sequence[Track]) -> None:
    """Copy the record of thinning from the tracks that a new track was computed from."""
    thinned = [one for one in inputs if one.removed]
    if thinned:
        errors_m = [one.thinned_m for one in thinned if one.thinned_m is not None]
        track.removed = sum(one.removed for one in thinned)
        track.thinned_m = max(errors_m) if len(errors_m) == len(thinned) else None
        track.thinned_poses = track.poses


def read(session: Session, track: Track, *, first: int = 0, stop: int | None = None) -> Poses:
    """Read poses of a track by their numbers.

    Args:
        first: Number of the first pose.
        stop: Number after the last; None for the end of the track.
    """
    stop = track.poses if stop is None else min(stop, track.poses)
    found = select(*_READ).where(Pose.track_id == track.id, Pose.number >= first, Pose.number < stop)
    return _poses(session, found.order_by(Pose.number))


def blocks(session: Session, track: Track, *, first: int = 0, size: int = _BLOCK) -> Iterator[Poses]:
    """Read a track of any length, block by block."""
    for begin in range(first, track.poses, size):
        yield read(session, track, first=begin, stop=begin + size)


def at(session: Session, track: Track, numbers: list[int]) -> Poses:
    """Read the poses with these numbers, which must ascend."""
    mine = select(*_READ).where(Pose.track_id == track.id).order_by(Pose.number)
    parts = (numbers[begin : begin + _MOST_PARAMETERS] for begin in range(0, len(numbers), _MOST_PARAMETERS))
    return join([_poses(session, mine.where(Pose.number.in_(part))) for part in parts])


def fetched(session: Session, found: Select[tuple[object, ...]]) -> NDArray[np.float64]:
    """Read a table of numbers, (n, columns) float64; NULL becomes NaN."""
    result = session.connection().execute(found)
    assert result.cursor is not None
    rows = result.cursor.fetchall()  # directly from the driver: faster, and no conversion is needed
    result.close()
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(found.selected_columns))


def _poses(session: Session, found: Select[tuple[object, ...]]) -> Poses:
    table = fetched(session, found)
    return make_poses(
        table[:, 1],
        table[:, 2:4],
        height_m=table[:, 4],
        heading_deg=table[:, 5],
        covariance_m2=table[:, 6:9],
        travelled_m=table[:, 9],
    )


def _insert(session: Session, track: Track, poses: Poses) -> None:
    connection, insert = session.connection(), backend_of(session).insert
    connection.execute(delete(Pose).where(_are(track, track.poses, track.poses + len(poses))))
    for begin in range(0, len(poses), _BLOCK):
        block = poses.take(slice(begin, begin + _BLOCK))
        rows = _rows(track.id, track.poses + begin, block)
        insert(connection, Pose.__tablename__, columns=_COLUMNS, rows=rows)


def _rows(track_id: int, first: int, poses: Poses) -> list[tuple[float | None, ...]]:
    columns = (
        poses.times_s.tolist(),
        *poses.latlon.T.tolist(),
        *(_or_none(column) for column in (poses.height_m, poses.heading_deg, *poses.covariance_m2.T)),
        poses.travelled_m.tolist(),
    )
    return [(track_id, *row) for row in zip(range(first, first + len(poses)), *columns, strict=True)]


def _are(track: Track, first: int, stop: int) -> ColumnElement[bool]:
    return and_(Pose.track_id == track.id, Pose.number >= first, Pose.number < stop)


def _end(session: Session, track: Track) -> tuple[float, float, float] | None:
    if not track.poses:
        return None
    last = at(session, track, [track.poses - 1])
    return float(last.latlon[0, 0]), float(last.latlon[0, 1]), float(last.travelled_m[0])


def _or_none(column: NDArray[np.float64]) -> list[float | None]:
    return [None if value != value else value for value in column.tolist()]  # NaN != NaN


def _count(track: Track, poses: Poses, *, way_m: float) -> None:
    track.poses += len(poses)
    track.distance_m = way_m
    south, west = poses.latlon.min(axis=0).tolist()
    north, east = poses.latlon.max(axis=0).tolist()
    begin, end = float(poses.times_s.min()), float(poses.times_s.max())
    track.first_time_s = begin if track.first_time_s is None else min(begin, track.first_time_s)
    track.last_time_s = end if track.last_time_s is None else max(end, track.last_time_s)
    track.min_lat = south if track.min_lat is None else min(south, track.min_lat)
    track.max_lat = north if track.max_lat is None else max(north, track.max_lat)
    track.min_lon = west if track.min_lon is None else min(west, track.min_lon)
    track.max_lon = east if track.max_lon is None else max(east, track.max_lon)


@dataclass(frozen=True, slots=True)
class Piece:
    """Metadata of a piece, without its points."""

    chunk: int
    first_number: int
    count: int
    points: int
    bounds: tuple[float, float, float, float]  # South, west, north, east, degrees


def add_piece(
    session: Session, track: Track, *, level: int, chunk: int, count: int, points: NDArray[np.float64]
) -> None:
    """Store a piece of a track.

    Args:
        count: Number of poses that it represents.
        points: (m, 5) float64
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
    """Store the profile of a chunk, (m, 4) float64."""
    session.add(TrackProfile(track_id=track.id, chunk=chunk, points=points.astype(_FLOAT64).tobytes()))


def list_pieces(session: Session, track: Track, *, level: int) -> list[Piece]:
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


def piece_points(
    session: Session, track: Track, *, level: int, chunks: Sequence[int]
) -> list[NDArray[np.float64]]:
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
