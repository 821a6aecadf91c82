"""Points of landmarks on disk: their colours, their positions on the map, and PLY for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.errors import IndexDamaged
from webapp.files.localize.arrays import read_arrays, write_settled

COLOURS_FILE = "colours.arrays"
POINTS_FILE = "points.arrays"
_FORMAT = 1

Colours = NDArray[np.uint8]


def write_colours(path: Path, rgb: Colours, *, key: str) -> None:
    """Replace the file atomically. Raises StorageError.

    Args:
        rgb: (k, 3) uint8. Colours of the points of a cloud.
        key: Key of that cloud.
    """
    write_settled(path, {"rgb": rgb}, meta={"format": _FORMAT, "key": key})


def read_colours(path: Path, *, key: str) -> Colours | None:
    """Read the colours of a cloud's points; None if the file is missing, unusable or of another cloud."""
    try:
        arrays, meta = read_arrays(path)
        return arrays["rgb"] if (meta["format"], meta["key"]) == (_FORMAT, key) else None
    except (IndexDamaged, KeyError):
        return None


@dataclass(frozen=True, slots=True, eq=False)
class MapPoints:
    """Points of landmarks in the frame of their map, in any order."""

    key: str  # Identifies the inputs from which they were computed
    xyz: NDArray[np.float32]  # (k, 3) float32
    rgb: Colours  # (k, 3) uint8
    times_seen: NDArray[np.uint8]  # (k,) uint8. Number of photos that see each point; 255 means 255 or more.
    about: Mapping[str, Any]  # JSON values that are stored with the points


def write_points(path: Path, points: MapPoints) -> None:
    """Replace the file atomically. Raises StorageError."""
    arrays: dict[str, NDArray[Any]] = {"xyz": points.xyz, "rgb": points.rgb, "times_seen": points.times_seen}
    write_settled(path, arrays, meta={"format": _FORMAT, "key": points.key, "about": dict(points.about)})


def read_points(path: Path) -> MapPoints | None:
    """Read points; None if the file is missing or unusable."""
    try:
        arrays, meta = read_arrays(path)
        if meta["format"] != _FORMAT:
            return None
        return MapPoints(str(meta["key"]), about=meta["about"], **arrays)
    except (IndexDamaged, KeyError, TypeError):
        return None


def as_ply(points: MapPoints) -> bytes:
    """Write points as PLY (binary, little-endian): x, y, z, red, green, blue."""
    names = ("x", "y", "z", "red", "green", "blue")
    kinds = ("<f4",) * 3 + ("u1",) * 3
    table = np.empty(len(points.xyz), np.dtype(list(zip(names, kinds, strict=True))))
    for column, name in enumerate(names):
        table[name] = points.xyz[:, column] if column < 3 else points.rgb[:, column - 3]
    properties = [
        f"property {'float' if kind == '<f4' else 'uchar'} {name}"
        for name, kind in zip(names, kinds, strict=True)
    ]
    about = f"comment {points.about['frame']}"
    head = ["ply", "format binary_little_endian 1.0", about, f"element vertex {len(table)}", *properties]
    return "\n".join([*head, "end_header", ""]).encode() + table.tobytes()
