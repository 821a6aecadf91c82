"""Reads a file with tracks, in any format, into poses and objects on the Earth.

The order is always: read, georeference, leave out invalid positions, measure the distance, and only then
leave out poses that hardly moved.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath

from webapp.errors import ExpMapError, TrackError
from webapp.files.gate import Budget
from webapp.missions.core.trajectory.records import Poses, Sighting, Source, join
from webapp.missions.files import guarded_reader
from webapp.missions.files.readers.rosbag import Topic
from webapp.missions.files.track_chunks import Findings, Piece, Skipped
from webapp.missions.files.track_format import Selection, TrackFormat
from webapp.missions.files.track_reader import kind_of
from webapp.missions.tasks.place_track import ReadOptions, TrackPlacer, TrackSegment, one_line
from webapp.progress import Progress

_MAX_TITLE = 200


@dataclass(frozen=True, slots=True, eq=False)
class ReadTrack:
    """A complete track."""

    name: str
    source: Source
    poses: Poses
    skipped: int  # Number of poses that `min_move` left out
    distance_m: float  # Along all poses, including those left out


@dataclass(frozen=True, slots=True, eq=False)
class ReadReport:
    """The content of a file."""

    kind: str  # Format of the file, for display
    tracks: tuple[ReadTrack, ...]
    sightings: tuple[Sighting, ...]
    skipped: tuple[Skipped, ...]  # Items that could not be used, with reasons
    doubts: tuple[Skipped, ...]  # Implausible items, which are included unchanged
    notes: tuple[str, ...]  # Sentences on how the file was interpreted


def read_track(
    path: Path, *, options: ReadOptions | None = None, progress: Progress | None = None
) -> ReadReport:
    """Read a whole file into memory; use `stream` for large files.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        progress: One step per pose or object.

    Raises:
        TrackError: The file is damaged, of an unknown format, or has no usable content.
        UsageError: The given columns do not fit the table.
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
    kind = file_kind(path, options or ReadOptions()).title
    notes = tuple(findings.notes)
    return ReadReport(kind, tracks, tuple(sightings), findings.skipped(), findings.doubts(), notes)


def topics(path: Path) -> list[Topic]:
    """List the topics of a bag.

    Raises:
        TrackError: The file is damaged, or not a bag.
    """
    with about_file(path):
        kind = kind_of(path)
        if kind.suffix is None:
            raise TrackError(f"only bags have topics, this is {kind.title}")
        return guarded_reader.topics(path, kind)


def title(file: str, track: str) -> str:
    """Return the name of an imported track: the file's name without suffix, and the track's name there.

    Args:
        file: Name of the file, with its suffix.
        track: May be empty.
    """
    return one_line(f"{PurePath(file).stem} {track}", most=_MAX_TITLE)


def stream(
    path: Path,
    *,
    options: ReadOptions,
    findings: Findings,
    progress: Progress | None = None,
    now_s: float | None = None,
    budget: Budget | None = None,
) -> Iterator[TrackSegment | tuple[Sighting, ...]]:
    """Read a file piece by piece; the same file with the same options yields the same pieces.

    Parameters and errors are those of `read_track`, and:

    Args:
        findings: Filled with items that are left out or doubtful, and with notes.
        now_s: Seconds since 1970; later times are doubtful.
        budget: What reading may cost; by default as the default settings say.
    """
    progress = progress or Progress()
    with about_file(path):
        found = False
        places = TrackPlacer(options, findings, time.time() if now_s is None else now_s)
        pieces = file_pieces(path, options=options, findings=findings, progress=progress, budget=budget)
        for piece in pieces:
            progress.check()
            for part in places.placed(piece):
                found = True
                progress.advance(
                    len(part.poses) + part.skipped if isinstance(part, TrackSegment) else len(part)
                )
                yield part
        if not found and not findings.drawn:
            raise TrackError(findings.nothing_usable())


def file_pieces(
    path: Path,
    *,
    options: ReadOptions,
    findings: Findings,
    progress: Progress,
    budget: Budget | None = None,
) -> Iterator[Piece]:
    """Yield the pieces of a file, before they are georeferenced; raises as `guarded_reader.read`."""
    selection = Selection(options.topics, options.columns, options.axes)
    yield from guarded_reader.read(
        path,
        file_kind(path, options),
        selection=selection,
        findings=findings,
        progress=progress,
        budget=budget,
    )


def file_kind(path: Path, options: ReadOptions) -> TrackFormat:
    """Detect the format of a file; with `columns` it is a table. Raises as `kind_of`."""
    return kind_of(path, table=options.columns is not None)


@contextmanager
def about_file(path: Path) -> Iterator[None]:
    """Add the name of the file to errors."""
    try:
        yield
    except ExpMapError as error:
        if isinstance(error, TrackError):
            error.where = f"{path.name}: {error.where}" if error.where else path.name
        raise
