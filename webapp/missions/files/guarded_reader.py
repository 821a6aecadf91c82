"""Reads a file with tracks behind the gate for files of strangers: in a child process with limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from webapp.errors import TrackError
from webapp.files import gate
from webapp.files.gate import Budget
from webapp.missions.files import track_reader
from webapp.missions.files.piece_messages import (
    Remark,
    decode,
    piece_messages,
    remark_message,
    values_message,
)
from webapp.missions.files.readers import rosbag
from webapp.missions.files.readers.rosbag import Topic
from webapp.missions.files.track_chunks import Findings, Piece, RobotPiece, WorldPiece
from webapp.missions.files.track_format import Selection, TrackFormat
from webapp.progress import Progress
from webapp.settings import FileLimits

MAX_TRACKS = 10_000
"""Tracks of one file: each takes memory and a record until the end of an import."""


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
            found = decode(message)
            if isinstance(found, tuple):
                _remark(found, findings)
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
    return [Topic(*decode(message)) for message in messages]  # type: ignore[misc]


def messages(path: str, kind: str, *, selection: dict[str, Any]) -> Iterator[bytes]:
    """Yield pieces as messages, and remarks before the piece that follows them; called in the child."""
    chosen = Selection(**{**selection, "topics": tuple(selection["topics"])})
    findings = _Remarks()
    for piece in track_reader.read(Path(path), kind, selection=chosen, findings=findings):
        yield from map(remark_message, findings.taken())
        yield from piece_messages(piece)
    yield from map(remark_message, findings.taken())


def topic_messages(path: str, suffix: str) -> Iterator[bytes]:
    """Yield the topics of a bag as messages; called in the child."""
    for topic in rosbag.topics(Path(path), suffix=suffix):
        yield values_message((topic.name, topic.type, topic.messages, topic.readable))


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


def _remark(remark: Remark, findings: Findings) -> None:
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

    def taken(self) -> list[Remark]:
        """Return the remarks, and forget them."""
        new, self._new = self._new, {}
        return [(method, text, where, count) for (method, text), (where, count) in new.items()]

    def _add(self, method: str, text: str, *, where: str, count: int) -> None:
        if count:
            first, before = self._new.get((method, text), (where, 0))
            self._new[method, text] = (first, before + count)
