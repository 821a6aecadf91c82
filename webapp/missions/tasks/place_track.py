"""Georeferences the pieces of a track file one by one, and reports implausible data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.files.exchange.times import utc
from webapp.missions.core.trajectory.axes import Axes
from webapp.missions.core.trajectory.distance import Odometer
from webapp.missions.core.trajectory.records import Poses, Sighting, Source
from webapp.missions.core.trajectory.robotframe import Anchor, RobotFrame, Start, anchor_of
from webapp.missions.core.trajectory.thinning import MinMove, Thinner
from webapp.missions.files.track_chunks import (
    BAD_POSITION,
    Findings,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)

_MOST_S = 1e11
"""In the year 5138: larger numbers are not seconds since 1970."""
_RECEIVERS_S = 315_964_800.0
"""The GPS epoch, 1980-01-06: no receiver reports an earlier time."""
_AHEAD_S = 86_400.0
_MAX_NAME = 100
BAD_TIME = "poses or objects with an invalid time"
TOO_EARLY = "poses dated before 1980, when no receiver existed: perhaps seconds since a start, or days"
TOO_LATE = "poses dated in the future"
BACKWARDS = "poses dated earlier than the previous pose"
NULL_ISLAND = "positions at 0, 0, as written by receivers without a fix"
NO_START = "poses in the robot's own frame: the mission needs a start position and heading for them"


@dataclass(frozen=True, slots=True)
class ReadOptions:
    start: Start | None = None  # Start pose of the robot; needed for poses in its own frame
    min_move: MinMove = field(default_factory=MinMove)
    topics: tuple[str, ...] = ()  # Only these topics of a bag, or lines of a KML; empty for all
    columns: str | None = None  # Meaning of the columns of a table (`webapp.core.columns`); None to infer it
    source: Source | None = None  # Source of all tracks; None to infer it from the file
    axes: Axes | None = None  # Axes of frames in TUM, KITTI and tables; None to detect them
    # Only these tracks; None for all. Objects are not tracks.
    tracks: tuple[tuple[Source, str], ...] | None = None

    def key(self, piece: WorldPiece | RobotPiece) -> tuple[Source, str]:
        """Return source and name of the track to which a piece belongs."""
        return self.source or piece.source, piece.track

    def wants(self, piece: WorldPiece | RobotPiece) -> bool:
        """Return whether a piece belongs to a selected track."""
        return self.tracks is None or self.key(piece) in self.tracks


@dataclass(frozen=True, slots=True, eq=False)
class TrackSegment:
    """The next poses of a track, with the distance travelled."""

    track: str
    source: Source
    poses: Poses  # Poses that are kept; may be empty
    skipped: int  # Number of poses of this part that `min_move` left out
    travelled_m: float  # At the end of the part, including poses that were left out
    timed: bool  # As in `webapp.missions.files.track_chunks.WorldPiece`


@dataclass(slots=True)
class TrackPlacer:
    """Georeferences pieces; keeps the state of each track and frame."""

    options: ReadOptions
    findings: Findings  # Filled with items that are left out or doubtful
    now_s: float  # Seconds since 1970; later times are doubtful
    _meters: dict[tuple[Source, str], tuple[Odometer, Thinner]] = field(default_factory=dict)
    _frames: dict[str, RobotFrame] = field(default_factory=dict)
    _bodies: dict[str, RobotFrame] = field(default_factory=dict)
    _last_s: dict[tuple[Source, str], float] = field(default_factory=dict)

    def placed(self, piece: Piece) -> Iterator[TrackSegment | tuple[Sighting, ...]]:
        """Yield the usable parts of a piece."""
        match piece:
            case WorldPiece():
                if self.options.wants(piece):
                    yield from self._part(piece, piece.poses)
            case RobotPiece():
                yield from self._of_robot(piece)
            case WorldObjects():
                yield from self._objects(piece.sightings)
            case RobotObjects():
                yield from self._objects(tuple(self._on_earth(piece)))

    def _of_robot(self, piece: RobotPiece) -> Iterator[TrackSegment]:
        """Georeference poses; also those of tracks that are not selected, since objects may need them."""
        wanted = self.options.wants(piece)
        if self.options.start is not None:
            poses = self._poses(piece, self.options.start)
            if wanted:
                yield from self._part(piece, poses)
        elif wanted:
            self.findings.skip(NO_START, where=piece.track or "line 1", count=len(piece.poses))

    def _part(self, piece: WorldPiece | RobotPiece, poses: Poses) -> Iterator[TrackSegment]:
        where = piece.track or "line 1"
        placed = _on_the_earth(poses.latlon)
        self.findings.skip(BAD_POSITION, where=where, count=len(poses) - int(placed.sum()))
        timed = np.abs(poses.times_s) <= _MOST_S
        self.findings.skip(BAD_TIME, where=where, count=int((placed & ~timed).sum()))
        poses = poses.take(placed & timed)
        if not len(poses):
            return
        key = self.options.key(piece)
        self.findings.doubt(NULL_ISLAND, where=where, count=int((poses.latlon == 0.0).all(axis=1).sum()))
        self.doubt_times(piece, poses.times_s)
        odometer, thinner = self._meters.setdefault(key, (Odometer(), Thinner(self.options.min_move)))
        travelled = odometer.add(poses.latlon)
        measured = Poses(
            poses.times_s,
            poses.latlon,
            poses.height_m,
            poses.heading_deg,
            poses.covariance_m2,
            travelled,
        )
        before = thinner.skipped
        kept = measured.take(thinner.keep(poses.latlon))
        skipped = thinner.skipped - before
        yield TrackSegment(piece.track, key[0], kept, skipped, odometer.metres, piece.timed)

    def doubt_times(self, piece: WorldPiece | RobotPiece, times_s: NDArray[np.float64]) -> None:
        """Count the implausible times of a piece (n,), n > 0."""
        if not piece.timed:
            return
        where = piece.track or "line 1"
        early, late = times_s < _RECEIVERS_S, times_s > self.now_s + _AHEAD_S
        self.findings.doubt(TOO_EARLY, where=f"{where}, {_day(times_s.min())}", count=int(early.sum()))
        self.findings.doubt(TOO_LATE, where=f"{where}, {_day(times_s.max())}", count=int(late.sum()))
        key = (piece.source, piece.track)
        before = np.concatenate([[self._last_s.get(key, times_s[0])], times_s[:-1]])
        self.findings.doubt(BACKWARDS, where=where, count=int((times_s < before).sum()))
        self._last_s[key] = float(times_s[-1])

    def _poses(self, piece: RobotPiece, start: Start) -> Poses:
        """Align the first pose of the frame with the start; keep the last pose of its body as a frame."""
        if piece.frame not in self._frames:
            self._frames[piece.frame] = RobotFrame(start, anchor_of(piece.poses))
        frame = self._frames[piece.frame]
        poses = frame.poses(piece.poses)
        if piece.body and not np.isnan(poses.heading_deg[-1]):
            lat, lon = poses.latlon[-1].tolist()
            z = float(poses.height_m[-1])
            body = Start(LatLon(lat, lon), float(poses.heading_deg[-1]))
            self._bodies[piece.body] = RobotFrame(body, Anchor(z_m=-z))
        return poses

    def _on_earth(self, piece: RobotObjects) -> Iterator[Sighting]:
        frame = self._frames.get(piece.frame) or self._bodies.get(piece.frame)
        if frame is None:
            reason = f"objects in the frame {piece.frame!r}, of which no pose is known"
            first = piece.sightings[0]
            self.findings.skip(reason, where=first.object_id or first.kind, count=len(piece.sightings))
            return
        places = np.array([one.xyz_m for one in piece.sightings])
        for one, (lat, lon) in zip(
            piece.sightings, frame.latlon_from_xy(places[:, :2]).tolist(), strict=True
        ):
            height = one.xyz_m[2] - frame.anchor.z_m
            at = LatLon(lat, lon)
            yield Sighting(one.object_id, one.kind, one.time_s, at, height, one.confidence, size_m=one.size_m)

    def _objects(self, sightings: tuple[Sighting, ...]) -> Iterator[tuple[Sighting, ...]]:
        placed = [one for one in sightings if _on_the_earth(np.array([one.latlon]))[0]]
        self.findings.skip(BAD_POSITION, where="objects", count=len(sightings) - len(placed))
        good = tuple(_tidy(one) for one in placed if abs(one.time_s) <= _MOST_S)
        self.findings.skip(BAD_TIME, where="objects", count=len(placed) - len(good))
        if good:
            yield good


def _day(time_s: float) -> str:
    return utc([time_s])[0][:10]


def _on_the_earth(latlon: np.ndarray) -> np.ndarray:
    """Return which positions (n, 2) are valid: (n,) bool."""
    good: np.ndarray = (np.abs(latlon) <= (90.0, 180.0)).all(axis=1)
    return good


def _tidy(seen: Sighting) -> Sighting:
    """Sanitise a sighting: names on one line and of limited length, no invalid confidence."""
    sure = seen.confidence is not None and 0.0 <= seen.confidence <= 1.0
    return replace(
        seen,
        object_id=None if seen.object_id is None else one_line(seen.object_id),
        kind=one_line(seen.kind),
        confidence=seen.confidence if sure else None,
    )


def one_line(text: str, *, most: int = _MAX_NAME) -> str:
    """Return a name without unprintable characters, or `?` if nothing is left."""
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    return " ".join(printable.split())[:most].strip() or "?"
