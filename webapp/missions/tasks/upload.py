"""A file on its way into a mission: where it waits for its job, and how it is to be read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from webapp.core.trajectory.records import SOURCES, Source
from webapp.core.trajectory.thinning import MinMove, parse_min_move
from webapp.errors import UsageError
from webapp.missions.tasks.import_file import Order
from webapp.missions.tasks.read_track import ReadOptions
from webapp.store.library import Library


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


def order_of(path: Path, told: Mapping[str, Any]) -> Order:
    """Read how a file is to be imported, as a form or a job has it.

    Parameters
    ----------
    told : mapping
        `name`; and where they are known `source`, `min_move`, `columns`, and `topics`, separated by commas.

    Raises
    ------
    UsageError
        The source or the threshold is none.
    """
    topics = tuple(name for part in (told.get("topics") or "").split(",") if (name := part.strip()))
    min_move = parse_min_move(told["min_move"]) if told.get("min_move") else MinMove()
    columns, source = told.get("columns") or None, source_of(told.get("source"))
    options = ReadOptions(topics=topics, min_move=min_move, columns=columns, source=source)
    return Order(path, told["name"], options)


def source_of(text: str | None) -> Source | None:
    """Read where poses come from; None for what the file itself says.

    Raises
    ------
    UsageError
        It is no source.
    """
    if not text:
        return None
    found = next((source for source in SOURCES if source == text), None)
    if found is None:
        raise UsageError(f"{text[:40]!r} is no source", where="source", hint=f"use {', '.join(SOURCES)}")
    return found
