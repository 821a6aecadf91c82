"""What of a file is to be imported, and how: as forms, jobs and the keys of imports have it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from webapp.core.trajectory.axes import parse_axes
from webapp.core.trajectory.records import SOURCES, Source
from webapp.core.trajectory.robotframe import parse_start
from webapp.core.trajectory.thinning import MinMove, parse_min_move
from webapp.errors import UsageError
from webapp.missions.tasks.place_track import ReadOptions
from webapp.store.library import Library


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be imported.

    Attributes
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    name : str
        What its sender calls it: tracks are named after it.
    options : ReadOptions
        Without a start, the mission's own counts.
    """

    path: Path
    name: str
    options: ReadOptions


def waiting_path(library: Library, token: str) -> Path:
    """Where an uploaded file waits for its import; its folder is made when missing.

    Parameters
    ----------
    token : str
        Of hexadecimal digits.
    """
    folder = library.inner / "imports"
    folder.mkdir(exist_ok=True)
    return folder / f"{int(token, 16):032x}.track"


def order_of(path: Path, form: Mapping[str, Any]) -> Order:
    """Read how a file is to be imported, as a form or a job has it.

    Parameters
    ----------
    form : mapping
        `name`; and where they are known `source`, `min_move`, `columns`, `axes`, `start` as latitude,
        longitude and heading, `topics`, separated by commas, and `tracks`, pairs of source and name.

    Raises
    ------
    UsageError
        One of them is not valid.
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
    """Read where poses come from; None for what the file itself says.

    Raises
    ------
    UsageError
        It is not a source.
    """
    if not text:
        return None
    found = next((source for source in SOURCES if source == text), None)
    if found is None:
        raise UsageError(f"{text[:40]!r} is not a source", where="source", hint=f"use {', '.join(SOURCES)}")
    return found


def options_key(options: ReadOptions) -> str:
    """Write options as the keys of imports have them since 0.7.0: a file imported then is recognized."""
    known = ((field.name, getattr(options, field.name)) for field in fields(options))
    later = ("axes", "tracks")
    values = ", ".join(f"{name}={value!r}" for name, value in known if name not in later or value is not None)
    return f"Wishes({values})"
