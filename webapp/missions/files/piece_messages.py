"""Pieces of a track file and remarks on it as messages of bytes: JSON in one line, and perhaps a table.

The messages come from a process that parsed a file of a stranger: nothing in them is executed when they are
decoded, unlike in pickles.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.records import Poses, Sighting
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files.track_chunks import (
    CHUNK,
    LocalSighting,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)

Remark = tuple[str, str, str, int]
"""Method of `Findings`; its text, `where` and `count`."""

_WORLD, _LOCAL = (1, 2, 1, 1, 3, 1), (1, 3, 1, 3)
"""Numbers of columns of the fields of `Poses` and of `LocalPoses`."""


def piece_messages(piece: Piece) -> Iterator[bytes]:
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


def remark_message(remark: Remark) -> bytes:
    """Encode a remark."""
    return _message(["remark", *remark])


def values_message(values: Sequence[Any]) -> bytes:
    """Encode a list of other values of JSON types."""
    return _message(["values", *values])


def decode(message: bytes) -> Piece | Remark | list[Any]:
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
