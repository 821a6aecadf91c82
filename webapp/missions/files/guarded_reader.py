"""Reads a file with tracks behind the gate for files of strangers: in a child process with limits.

The child sends pieces of the file and remarks on it as messages of bytes: JSON in one line, and perhaps a
table. Nothing in them is executed when they are decoded, unlike in pickles.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.errors import TrackError
from webapp.files import gate
from webapp.files.gate import Budget
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.records import Poses, Sighting
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files import track_reader
from webapp.missions.files.drawn import FoundDrawing
from webapp.missions.files.readers import rosbag
from webapp.missions.files.readers.rosbag import Topic
from webapp.missions.files.track_chunks import (
    CHUNK,
    Findings,
    LocalSighting,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)
from webapp.missions.files.track_format import Selection, TrackFormat
from webapp.progress import Progress
from webapp.settings import FileLimits

MAX_TRACKS = 10_000
"""Tracks of one file: each takes memory and a record until the end of an import."""

_Remark = tuple[str, str, str, int]
"""Method of `Findings`; its text, `where` and `count`."""

_WORLD, _LOCAL = (1, 2, 1, 1, 3, 1), (1, 3, 1, 3)
"""Numbers of columns of the fields of `Poses` and of `LocalPoses`."""


def read(
    path: Path,
    kind: TrackFormat,
    *,
    selection: Selection,
    findings: Findings,
    progress: Progress,
    budget: Budget | None = None,
) -> Iterator[Piece]:
    """Yield the pieces of a file, before they are georeferenced.

    Parameters and errors are those of `track_reader.read`, and:

    Args:
        progress: Checked while waiting for pieces.
        budget: By default that of the default settings.

    Raises:
        TooSlow: Reading takes more time than the budget.
        TrackError: Reading takes more memory than the budget, or the file has more than `MAX_TRACKS` tracks.
        Cancelled
    """
    tracks: set[str] = set()
    arguments = {"path": str(path), "kind": kind.name, "selection": asdict(selection)}
    with closing(_run("messages", arguments, kind=kind, progress=progress, budget=budget)) as messages:
        for message in messages:
            found = _decode(message)
            if isinstance(found, tuple):
                _remark(found, findings)
                continue
            if isinstance(found, FoundDrawing):
                findings.draw(found, where="")
                continue
            if isinstance(found, dict):
                findings.looks |= found
                continue
            assert not isinstance(found, list), "pieces and remarks only"
            if isinstance(found, WorldPiece | RobotPiece):
                tracks.add(found.track)
                if len(tracks) > MAX_TRACKS:
                    raise TrackError(f"the file has more than {MAX_TRACKS} tracks", hint="split it")
            yield found


def topics(path: Path, kind: TrackFormat) -> list[Topic]:
    """List the topics of a bag.

    Raises:
        TrackError: The bag is damaged, or reading it takes more than the default settings allow.
    """
    messages = _run("topic_messages", {"path": str(path), "suffix": kind.suffix}, kind=kind)
    return [Topic(*_decode(message)) for message in messages]  # type: ignore[misc]


def messages(path: str, kind: str, *, selection: dict[str, Any]) -> Iterator[bytes]:
    """Yield pieces as messages, and remarks before the piece that follows them; called in the child."""
    chosen = Selection(**{**selection, "topics": tuple(selection["topics"])})
    findings = _Remarks()
    for piece in track_reader.read(Path(path), kind, selection=chosen, findings=findings):
        yield from map(_remark_message, findings.taken())
        yield from _piece_messages(piece)
    yield from map(_remark_message, findings.taken())
    for drawing in findings.drawn:
        yield _message(["drawn", asdict(drawing)])
    for track, look in findings.looks.items():
        yield _message(["look", track, asdict(look)])


def topic_messages(path: str, suffix: str) -> Iterator[bytes]:
    """Yield the topics of a bag as messages; called in the child."""
    for topic in rosbag.topics(Path(path), suffix=suffix):
        yield _values_message((topic.name, topic.type, topic.messages, topic.readable))


def _run(
    name: str,
    arguments: dict[str, Any],
    *,
    kind: TrackFormat,
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> Any:
    path = Path(arguments["path"])
    return gate.run(
        f"{__name__}:{name}",
        arguments,
        budget=budget or gate.budget_for(path, FileLimits()),
        progress=progress,
        preload=kind.preload,
        may_write=None if kind.scratch is None else round(kind.scratch * gate.size_of(path)),
    )


def _remark(remark: _Remark, findings: Findings) -> None:
    method, text, where, count = remark
    if method == "note":
        findings.note(text)
    elif method == "doubt":
        findings.doubt(text, where=where, count=count)
    else:
        findings.skip(text, where=where, count=count)


class _Remarks(Findings):
    """Remarks since the last piece, those of one kind as one."""

    def __init__(self) -> None:
        super().__init__()
        self._new: dict[tuple[str, str], tuple[str, int]] = {}

    def skip(self, reason: str, *, where: str, count: int = 1) -> None:
        self._add("skip", reason, where=where, count=count)

    def doubt(self, reason: str, *, where: str, count: int = 1) -> None:
        self._add("doubt", reason, where=where, count=count)

    def note(self, sentence: str) -> None:
        if sentence and sentence not in self.notes:
            self.notes.append(sentence)
            self._add("note", sentence, where="", count=1)

    def taken(self) -> list[_Remark]:
        new, self._new = self._new, {}
        return [(method, text, where, count) for (method, text), (where, count) in new.items()]

    def _add(self, method: str, text: str, *, where: str, count: int) -> None:
        if count:
            first, before = self._new.get((method, text), (where, 0))
            self._new[method, text] = (first, before + count)


def _piece_messages(piece: Piece) -> Iterator[bytes]:
    """Encode a piece; many objects become several messages, and several pieces."""
    if isinstance(piece, WorldPiece):
        yield _message(["world", piece.track, piece.source, piece.timed], astuple(piece.poses))
    elif isinstance(piece, RobotPiece):
        head = ["robot", piece.track, piece.source, piece.frame, piece.body, piece.timed]
        yield _message(head, astuple(piece.poses))
    else:
        head = ["seen"] if isinstance(piece, WorldObjects) else ["seen locally", piece.frame]
        for first in range(0, len(piece.sightings), CHUNK):
            yield _message([*head, [astuple(one) for one in piece.sightings[first : first + CHUNK]]])


def _remark_message(remark: _Remark) -> bytes:
    return _message(["remark", *remark])


def _values_message(values: Sequence[Any]) -> bytes:
    """Encode a list of other values of JSON types."""
    return _message(["values", *values])


def _decode(message: bytes) -> Piece | _Remark | FoundDrawing | dict[str, TrackLook] | list[Any]:
    text, _, data = message.partition(b"\n")
    found: list[Any] = json.loads(text)
    kind, rest = found[0], found[1:]
    match kind:
        case "world":
            track, source, timed = rest
            return WorldPiece(track, source, Poses(*_columns(data, _WORLD)), timed)
        case "robot":
            track, source, frame, body, timed = rest
            return RobotPiece(track, source, frame, body, LocalPoses(*_columns(data, _LOCAL)), timed)
        case "seen":
            return WorldObjects(tuple(Sighting(*_fields(row, LatLon)) for row in rest[0]))
        case "seen locally":
            return RobotObjects(rest[0], tuple(LocalSighting(*_fields(row, tuple)) for row in rest[1]))
        case "drawn":
            points = tuple(tuple(point) for point in rest[0]["points"])
            return FoundDrawing(**{**rest[0], "points": points})
        case "look":
            return {rest[0]: TrackLook(**rest[1])}
        case "remark":
            method, what, where, count = rest
            return method, what, where, count
    return rest


def _message(head: list[Any], arrays: Sequence[NDArray[np.float64]] = ()) -> bytes:
    text = json.dumps(head).encode()
    return text + b"\n" + (np.column_stack(arrays).tobytes() if arrays else b"")


def _columns(data: bytes, widths: Sequence[int]) -> Iterator[NDArray[np.float64]]:
    """Split a table into arrays (n,) and (n, width)."""
    table = np.frombuffer(data, dtype=np.float64).reshape(-1, sum(widths))
    first = 0
    for width in widths:
        yield table[:, first].copy() if width == 1 else table[:, first : first + width].copy()
        first += width


def _fields(row: list[Any], place: type[LatLon] | type[tuple[Any, ...]]) -> Iterator[Any]:
    """Convert lists to tuples; the fourth field is the position."""
    for index, value in enumerate(row):
        if index == _PLACE:
            yield LatLon(*value) if place is LatLon else tuple(value)
        else:
            yield tuple(value) if isinstance(value, list) else value


_PLACE = 3
