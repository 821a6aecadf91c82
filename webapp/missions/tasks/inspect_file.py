"""Reports the content of a track file before it is imported: sources, times, extent, doubtful data."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.files.exchange.times import utc
from webapp.files.gate import Budget
from webapp.missions.core.trajectory.distance import Odometer
from webapp.missions.core.trajectory.propose_start import propose_start
from webapp.missions.core.trajectory.robotframe import Anchor, anchor_of
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.files.readers import csv_reader
from webapp.missions.files.readers.csv_table import TableHead, table_head
from webapp.missions.files.track_chunks import Findings, Piece, RobotPiece, Skipped, WorldPiece
from webapp.missions.tasks.place_track import ReadOptions, TrackPlacer, TrackSegment
from webapp.missions.tasks.read_track import about_file, file_kind, file_pieces
from webapp.progress import Progress

NEEDS_START = "a track in the robot's own frame needs a start position and heading to be imported"
_PREVIEW = 400
"""Minimum number of points of a preview line, if the source has as many; the maximum is twice that."""


@dataclass(frozen=True, slots=True)
class FileSource:
    # `source`, `track`: Source and name with which it will be imported.
    source: str
    track: str
    frame: str  # "earth" or "robot". A robot's frame needs a start.
    poses: int
    # `first_time_s`, `last_time_s`: Earliest and latest time, seconds since 1970, UTC; None if the track has
    # no times.
    first_time_s: float | None
    last_time_s: float | None
    # On the Earth the bounds `south`, `west`, `north`, `east`; in a robot's frame the size `x`, `y`, `z` in
    # metres.
    extent: dict[str, float]
    distance_m: float  # Along all poses, heights ignored
    # `headings`, `heights`: Number of poses that have one.
    headings: int
    heights: int
    # The track, thinned: latitude and longitude, or metres forward and left of the first pose in its frame.
    line: list[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class ProposedStart:
    """Position and heading of a robot at its start."""

    lat: float
    lon: float
    heading_deg: float


@dataclass(frozen=True, slots=True)
class FileReport:
    kind: str  # Format, for display
    sources: tuple[FileSource, ...]
    objects: int  # Number of sightings of objects
    # `skipped`, `doubts`: Items that would be left out, and implausible ones.
    skipped: tuple[Skipped, ...]
    doubts: tuple[Skipped, ...]
    notes: tuple[str, ...]  # How the file was interpreted
    options: tuple[str, ...] = ()  # Options that apply to this file: `columns`, `axes`
    table: TableHead | None = None  # Header and first rows of a table
    problem: str = ""  # Why nothing can be imported with these options; empty otherwise
    # Start of the robot, proposed if the file also has positions on the Earth from the same time.
    start: ProposedStart | None = None


def inspect_file(
    path: Path,
    *,
    options: ReadOptions | None = None,
    progress: Progress | None = None,
    now_s: float | None = None,
    budget: Budget | None = None,
) -> FileReport:
    """Read a file and report its content; nothing is stored, and no start is needed.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        progress: One step per pose or object.
        now_s: Seconds since 1970; later times are doubtful.
        budget: What reading may cost; by default as the default settings say.

    Raises:
        TrackError: The file is damaged, or its format unknown. Unrecognised columns of a table are a
            `problem` instead.
        UsageError: An option does not fit the file.
        Cancelled
    """
    options = replace(options or ReadOptions(), min_move=MinMove(0.0))
    progress, findings = progress or Progress(), Findings()
    with about_file(path):
        kind = file_kind(path, options)
        head = table_head(path, options.columns) if kind is csv_reader.FORMAT else None
        if head is not None and head.problem:
            return FileReport(kind.title, (), 0, (), (), (), ("columns",), head, head.problem)
        placer = TrackPlacer(options, findings, time.time() if now_s is None else now_s)
        found: dict[tuple[str, str, str], _Gathered] = {}
        anchors: dict[str, Anchor] = {}
        objects = 0
        pieces = file_pieces(path, options=options, findings=findings, progress=progress, budget=budget)
        for piece in pieces:
            progress.check()
            objects += _take(piece, placer, found=found, anchors=anchors)
            progress.advance(len(piece.poses) if isinstance(piece, WorldPiece | RobotPiece) else 1)
    sources = tuple(gathered.source(*key) for key, gathered in found.items())
    problem = "" if sources or objects or findings.drawn else findings.nothing_usable()
    if findings.drawn:
        findings.note(f"drawings (search areas, lines, markers) in the file: {len(findings.drawn)}")
    doubts, notes = findings.doubts(), tuple(findings.notes)
    in_metres = any(source.frame == "robot" for source in sources)
    may = (("columns", head is not None), ("axes", in_metres and kind.has_axes))
    return FileReport(
        kind.title,
        sources,
        objects,
        findings.skipped(),
        doubts,
        notes,
        tuple(name for name, does in may if does),
        head,
        problem,
        _start_of(found),
    )


def _start_of(found: Mapping[tuple[str, str, str], _Gathered]) -> ProposedStart | None:
    """Propose the start from the first track in metres and the one on the Earth that has the most poses."""
    timed = [(frame, one) for (frame, _, _), one in found.items() if one.timed]
    local = next((one for frame, one in timed if frame == "robot"), None)
    there = max((one for frame, one in timed if frame == "earth"), key=lambda one: one.poses, default=None)
    if local is None or there is None:
        return None
    start = propose_start(
        np.array(local.moments),
        np.array(local.line),
        fix_times_s=np.array(there.moments),
        fixes=np.array(there.line),
    )
    if start is None:
        return None
    return ProposedStart(
        round(start.position.lat, 8), round(start.position.lon, 8), round(start.heading_deg, 1)
    )


def as_json(report: FileReport, *, lines: bool = True) -> dict[str, Any]:
    """Convert a report to JSON types.

    Args:
        lines: Include the lines of the sources.
    """
    whole = asdict(report)
    for source in whole["sources"]:
        for name in ("first_time", "last_time"):
            at = source[f"{name}_s"]
            source[name] = None if at is None else utc([at])[0]
        if not lines:
            del source["line"]
    return whole


@dataclass(slots=True)
class _Gathered:
    """Statistics of a track so far, and its preview line of evenly spaced poses."""

    anchor: Anchor | None = None
    poses: int = 0
    headings: int = 0
    heights: int = 0
    timed: bool = False
    times: tuple[float, float] = (math.inf, -math.inf)
    low: NDArray[np.float64] = field(default_factory=lambda: np.full(3, math.inf))
    high: NDArray[np.float64] = field(default_factory=lambda: np.full(3, -math.inf))
    line: list[tuple[float, float]] = field(default_factory=list)
    moments: list[float] = field(default_factory=list)  # Times of `line`
    last: tuple[float, float] | None = None
    every: int = 1
    way: Odometer = field(default_factory=Odometer)
    way_m: float = 0.0  # In a robot's frame

    def add(
        self,
        times_s: NDArray[np.float64],
        place: NDArray[np.float64],
        *,
        heading: NDArray[np.float64],
        timed: bool,
    ) -> None:
        """Add poses: `place` (n, 3) is latitude, longitude, height, or metres."""
        drawn = place[:, :2] if self.anchor is None else _ahead(place[:, :2], self.anchor)
        self.line += map(tuple, drawn[-self.poses % self.every :: self.every].tolist())
        self.moments += times_s[-self.poses % self.every :: self.every].tolist()
        while len(self.line) > 2 * _PREVIEW:
            self.line, self.moments = self.line[::2], self.moments[::2]
            self.every *= 2
        self.poses += len(place)
        self.timed |= timed
        self.headings += int(np.isfinite(heading).sum())
        self.heights += int(np.isfinite(place[:, 2]).sum())
        self.times = (min(self.times[0], times_s.min()), max(self.times[1], times_s.max()))
        self.low = np.fmin(self.low, np.fmin.reduce(place, axis=0))
        self.high = np.fmax(self.high, np.fmax.reduce(place, axis=0))
        if self.anchor is None:
            self.way.add(place[:, :2])
        else:
            before = drawn[:1] if self.last is None else np.array([self.last])
            self.way_m += float(np.hypot(*np.diff(np.vstack([before, drawn]), axis=0).T).sum())
        self.last = (float(drawn[-1, 0]), float(drawn[-1, 1]))

    def source(self, frame: str, source: str, track: str) -> FileSource:
        first, last = (float(self.times[0]), float(self.times[1])) if self.timed else (None, None)
        line = self.line if self.last is None or self.line[-1] == self.last else [*self.line, self.last]
        extent = dict(zip("xyz", (self.high - self.low).tolist(), strict=True))
        if frame == "earth":
            (south, west, _), (north, east, _) = self.low.tolist(), self.high.tolist()
            extent = {"south": south, "west": west, "north": north, "east": east}
        way_m = self.way.metres + self.way_m
        return FileSource(
            source, track, frame, self.poses, first, last, extent, way_m, self.headings, self.heights, line
        )


def _take(
    piece: Piece,
    placer: TrackPlacer,
    *,
    found: dict[tuple[str, str, str], _Gathered],
    anchors: dict[str, Anchor],
) -> int:
    """Add a piece to the statistics in `found`; return its number of objects.

    Args:
        anchors: The first pose in each frame, which an import aligns with the start.
    """
    if isinstance(piece, RobotPiece):
        poses = piece.poses
        key = ("robot", placer.options.source or piece.source, piece.track)
        if key not in found:
            found[key] = _Gathered(anchors.setdefault(piece.frame, anchor_of(poses)))
            placer.findings.note(NEEDS_START)
        placer.doubt_times(piece, poses.times_s)
        found[key].add(poses.times_s, poses.xyz_m, heading=poses.yaw_rad, timed=piece.timed)
        return 0
    objects = 0
    for part in placer.placed(piece):
        if not isinstance(part, TrackSegment):
            objects += len(part)
            continue
        place = np.column_stack([part.poses.latlon, part.poses.height_m])
        gathered = found.setdefault(("earth", part.source, part.track), _Gathered())
        gathered.add(part.poses.times_s, place, heading=part.poses.heading_deg, timed=part.timed)
    return objects


def _ahead(xy_m: NDArray[np.float64], anchor: Anchor) -> NDArray[np.float64]:
    """Transform positions (n, 2) in a frame to metres forward and left of its first pose."""
    sin, cos = math.sin(anchor.yaw_rad), math.cos(anchor.yaw_rad)
    turned: NDArray[np.float64] = (xy_m - (anchor.x_m, anchor.y_m)) @ np.array([[cos, -sin], [sin, cos]])
    return turned
