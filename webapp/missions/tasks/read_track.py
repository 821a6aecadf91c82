"""Reads a file with tracks, of any kind, into poses and objects on the Earth.

The order is always: read, bring to the Earth, leave out what is not a position, measure the distance,
and only then leave out what did not move.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.distance import Odometer
from webapp.core.trajectory.records import Poses, Sighting, Source, join
from webapp.core.trajectory.robotframe import Anchor, RobotFrame, Start, anchor_of
from webapp.core.trajectory.thinning import MinMove, Thinner
from webapp.errors import ExpMapError, TrackError
from webapp.missions.files import csv_tables, gpx, kml_reader, nmea, rosbag, trajectory_text
from webapp.missions.files.kml_reader import opened_kml
from webapp.missions.files.rosbag import Topic
from webapp.missions.files.track_chunks import (
    BAD_POSITION,
    Findings,
    Piece,
    RobotObjects,
    RobotPiece,
    Skipped,
    WorldObjects,
    WorldPiece,
)
from webapp.missions.files.track_format import TITLES, Kind, kind_of
from webapp.progress import Progress

_SUFFIX: dict[Kind, str] = {"ros1": ".bag", "ros2-sqlite": ".db3", "ros2-mcap": ".mcap", "ros2-folder": ""}
_MOST_S = 1e11
"""In the year 5138: larger numbers are not seconds since 1970."""
_MAX_NAME = 100
_MAX_TITLE = 200
BAD_TIME = "poses or objects with an invalid time"
NO_START = "poses in the robot's own frame: the mission needs a start position and heading for them"


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options of reading a file with tracks.

    Attributes
    ----------
    start : Start or None
        Where the robot was at first; needed for poses in its own frame.
    topics : tuple of str
        Only these topics of a bag, or lines of a KML; empty for all.
    columns : str or None
        What the columns of a table hold (`webapp.core.columns`); None to guess.
    source : Source or None
        Of all tracks; None for what the kind of the file says.
    """

    start: Start | None = None
    min_move: MinMove = field(default_factory=MinMove)
    topics: tuple[str, ...] = ()
    columns: str | None = None
    source: Source | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TrackSegment:
    """The next poses of a track, with the way that they have come.

    Attributes
    ----------
    poses : Poses
        Those that are kept; may be none.
    skipped : int
        Poses of this part that were left out because they had not moved.
    travelled_m : float
        At the end of the part, poses that were left out included.
    timed : bool
        As in `webapp.missions.files.track_chunks.WorldPiece`.
    """

    track: str
    source: Source
    poses: Poses
    skipped: int
    travelled_m: float
    timed: bool


@dataclass(frozen=True, slots=True, eq=False)
class ReadTrack:
    """A track, whole.

    Attributes
    ----------
    skipped : int
        Poses left out because they had not moved.
    distance_m : float
        Along all poses, those left out included.
    """

    name: str
    source: Source
    poses: Poses
    skipped: int
    distance_m: float


@dataclass(frozen=True, slots=True, eq=False)
class ReadReport:
    """What was read of a file.

    Attributes
    ----------
    kind : str
        What the file is, for people.
    skipped : tuple of Skipped
        What could not be used, and why.
    notes : tuple of str
        Sentences on how the file was understood.
    """

    kind: str
    tracks: tuple[ReadTrack, ...]
    sightings: tuple[Sighting, ...]
    skipped: tuple[Skipped, ...]
    notes: tuple[str, ...]


def read_track(
    path: Path, *, options: ReadOptions | None = None, progress: Progress | None = None
) -> ReadReport:
    """Read a whole file into memory; for large ones there is `stream`.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    progress : Progress, optional
        One step a pose or object.

    Raises
    ------
    TrackError
        The file is damaged, of no kind that is known, or has nothing that can be used.
    UsageError
        The columns asked for are not there.
    Cancelled
    """
    findings = Findings()
    parts: dict[tuple[Source, str], list[TrackSegment]] = {}
    sightings: list[Sighting] = []
    for part in stream(path, options=options or ReadOptions(), findings=findings, progress=progress):
        if isinstance(part, TrackSegment):
            parts.setdefault((part.source, part.track), []).append(part)
        else:
            sightings += part
    tracks = tuple(
        ReadTrack(
            name,
            source,
            join([part.poses for part in track]),
            sum(part.skipped for part in track),
            track[-1].travelled_m,
        )
        for (source, name), track in parts.items()
    )
    kind = TITLES[_kind(path, options or ReadOptions())]
    return ReadReport(kind, tracks, tuple(sightings), findings.skipped(), tuple(findings.notes))


def topics(path: Path) -> list[Topic]:
    """List the topics of a bag.

    Raises
    ------
    TrackError
        It is damaged, or no bag.
    """
    with _about(path):
        kind = kind_of(path)
        if kind not in _SUFFIX:
            raise TrackError(f"only bags have topics, this is {TITLES[kind]}")
        return rosbag.topics(path, suffix=_SUFFIX[kind])


def title(file: str, track: str) -> str:
    """Name a track in a mission after the file that it came from, and what it is called there.

    Parameters
    ----------
    file : str
        Name of the file, with its ending.
    track : str
        May be empty.
    """
    return _one_line(f"{PurePath(file).stem} {track}", most=_MAX_TITLE)


def stream(
    path: Path, *, options: ReadOptions, findings: Findings, progress: Progress | None = None
) -> Iterator[TrackSegment | tuple[Sighting, ...]]:
    """Read a file piece by piece; the same file with the same options yields the same pieces.

    Parameters and errors are those of `read_track`, and:

    Parameters
    ----------
    findings : Findings
        Filled with what is left out and how the file is understood.
    """
    progress = progress or Progress()
    with _about(path):
        found = False
        places = _Places(options, findings)
        for piece in _pieces(path, _kind(path, options), options, findings=findings):
            progress.check()
            for part in places.placed(piece):
                found = True
                progress.advance(
                    len(part.poses) + part.skipped if isinstance(part, TrackSegment) else len(part)
                )
                yield part
        if not found:
            reasons = "; ".join(f"{one.count} {one.reason}" for one in findings.skipped())
            raise TrackError(f"nothing in it can be used{': ' + reasons if reasons else ''}")


@dataclass(slots=True)
class _Places:
    """Brings pieces to the Earth; knows how far each track has come."""

    options: ReadOptions
    findings: Findings
    _meters: dict[tuple[Source, str], tuple[Odometer, Thinner]] = field(default_factory=dict)
    _frames: dict[str, RobotFrame] = field(default_factory=dict)
    _bodies: dict[str, RobotFrame] = field(default_factory=dict)

    def placed(self, piece: Piece) -> Iterator[TrackSegment | tuple[Sighting, ...]]:
        match piece:
            case WorldPiece():
                yield from self._part(piece, piece.poses)
            case RobotPiece():
                if self.options.start is None:
                    self.findings.skip(NO_START, where=piece.track or "line 1", count=len(piece.poses))
                else:
                    yield from self._part(piece, self._poses(piece, self.options.start))
            case WorldObjects():
                yield from self._objects(piece.sightings)
            case RobotObjects():
                yield from self._objects(tuple(self._on_earth(piece)))

    def _part(self, piece: WorldPiece | RobotPiece, poses: Poses) -> Iterator[TrackSegment]:
        where = piece.track or "line 1"
        placed = _on_the_earth(poses.latlon)
        self.findings.skip(BAD_POSITION, where=where, count=len(poses) - int(placed.sum()))
        timed = np.abs(poses.times_s) <= _MOST_S
        self.findings.skip(BAD_TIME, where=where, count=int((placed & ~timed).sum()))
        poses = poses.take(placed & timed)
        if not len(poses):
            return
        key = (self.options.source or piece.source, piece.track)
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

    def _poses(self, piece: RobotPiece, start: Start) -> Poses:
        """Lay the frame so that its first pose is at the start, and remember where its body is last."""
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
            self.findings.skip(reason, where=piece.sightings[0].object_id, count=len(piece.sightings))
            return
        places = np.array([one.xyz_m for one in piece.sightings])
        for one, (lat, lon) in zip(
            piece.sightings, frame.latlon_from_xy(places[:, :2]).tolist(), strict=True
        ):
            height = one.xyz_m[2] - frame.anchor.z_m
            yield Sighting(one.object_id, one.kind, one.time_s, LatLon(lat, lon), height, one.confidence)

    def _objects(self, sightings: tuple[Sighting, ...]) -> Iterator[tuple[Sighting, ...]]:
        placed = [one for one in sightings if _on_the_earth(np.array([one.latlon]))[0]]
        self.findings.skip(BAD_POSITION, where="objects", count=len(sightings) - len(placed))
        good = tuple(_tidy(one) for one in placed if abs(one.time_s) <= _MOST_S)
        self.findings.skip(BAD_TIME, where="objects", count=len(placed) - len(good))
        if good:
            yield good


def _on_the_earth(latlon: np.ndarray) -> np.ndarray:
    """Return which positions (n, 2) are valid: (n,) bool."""
    good: np.ndarray = (np.abs(latlon) <= (90.0, 180.0)).all(axis=1)
    return good


def _tidy(seen: Sighting) -> Sighting:
    """Return a sighting as it can be kept: names on one line and not endless, a confidence that is one."""
    sure = seen.confidence is not None and 0.0 <= seen.confidence <= 1.0
    return replace(
        seen,
        object_id=_one_line(seen.object_id),
        kind=_one_line(seen.kind),
        confidence=seen.confidence if sure else None,
    )


def _one_line(text: str, *, most: int = _MAX_NAME) -> str:
    """Return a name without what cannot be shown; `?` for one that has nothing else."""
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    return " ".join(printable.split())[:most].strip() or "?"


def _pieces(path: Path, kind: Kind, options: ReadOptions, *, findings: Findings) -> Iterator[Piece]:
    if kind in _SUFFIX:
        suffix = _SUFFIX[kind]
        yield from rosbag.read(path, suffix=suffix, wanted=options.topics, findings=findings)
    elif kind == "kmz":
        with opened_kml(path) as packed:
            yield from kml_reader.read(packed, findings=findings, tracks=options.topics)
    else:
        with path.open("rb") as file:
            match kind:
                case "gpx":
                    yield from gpx.read(file, findings=findings)
                case "kml":
                    yield from kml_reader.read(file, findings=findings, tracks=options.topics)
                case "nmea":
                    yield from nmea.read(file, findings=findings)
                case "tum" | "kitti":
                    yield from trajectory_text.read(file, kind, findings=findings)
                case _:
                    yield from csv_tables.read(file, columns=options.columns, findings=findings)


def _kind(path: Path, options: ReadOptions) -> Kind:
    return kind_of(path, table=options.columns is not None)


@contextmanager
def _about(path: Path) -> Iterator[None]:
    """Say in errors which file they are about."""
    try:
        yield
    except ExpMapError as error:
        if isinstance(error, TrackError):
            error.where = f"{path.name}: {error.where}" if error.where else path.name
        raise
