"""Options of an import, and their formats in forms, jobs and import keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from webapp.errors import UsageError
from webapp.missions.core.trajectory.axes import parse_axes
from webapp.missions.core.trajectory.records import SOURCES, Source
from webapp.missions.core.trajectory.robotframe import parse_start
from webapp.missions.core.trajectory.thinning import MinMove, parse_min_move
from webapp.missions.tasks.place_track import ReadOptions
from webapp.store.library import Library


@dataclass(frozen=True, slots=True)
class Order:
    """A file to import, with options."""

    path: Path  # A file, or the folder of a ROS 2 bag
    name: str  # Original name of the file, after which tracks are named
    options: ReadOptions  # If `start` is None, that of the mission is used


def waiting_path(library: Library, token: str) -> Path:
    """Return the path of an uploaded file that waits for its import; create its folder if missing.

    Args:
        token: Hexadecimal digits.
    """
    folder = library.inner / "imports"
    folder.mkdir(exist_ok=True)
    return folder / f"{int(token, 16):032x}.track"


def order_of(path: Path, form: Mapping[str, Any]) -> Order:
    """Parse the options of an import from a form or the arguments of a job.

    Args:
        form: `name`, and optionally `source`, `min_move`, `columns`, `axes`, `start` as latitude, longitude
            and heading, `topics`, separated by commas, and `tracks`, pairs of source and name.

    Raises:
        UsageError: An option is invalid.
    """
    topics = tuple(name for part in (form.get("topics") or "").split(",") if (name := part.strip()))
    min_move = parse_min_move(form["min_move"]) if form.get("min_move") else MinMove()
    columns, source = form.get("columns") or None, source_of(form.get("source"))
    options = ReadOptions(
        start=parse_start(form.get("start")),
        topics=topics,
        min_move=min_move,
        columns=columns,
        source=source,
        axes=parse_axes(form.get("axes")),
        tracks=_tracks_of(form.get("tracks")),
    )
    return Order(path, form["name"], options)


def _tracks_of(pairs: Iterable[tuple[str, str]] | None) -> tuple[tuple[Source, str], ...] | None:
    if pairs is None:
        return None
    found = ((source_of(source), track) for source, track in pairs)
    return tuple(sorted((source, track) for source, track in found if source is not None))


def source_of(text: str | None) -> Source | None:
    """Parse the source of poses; None means that given by the file.

    Raises:
        UsageError: The text is not a source.
    """
    if not text:
        return None
    found = next((source for source in SOURCES if source == text), None)
    if found is None:
        raise UsageError(f"{text[:40]!r} is not a source", where="source", hint=f"use {', '.join(SOURCES)}")
    return found


def options_key(options: ReadOptions) -> str:
    """Format options for import keys; unchanged since 0.7.0, so that files imported then are recognised."""
    known = ((field.name, getattr(options, field.name)) for field in fields(options))
    later = ("axes", "tracks")
    values = ", ".join(f"{name}={value!r}" for name, value in known if name not in later or value is not None)
    return f"Wishes({values})"
