"""Files of an index: orientations of a map's photos, depths of keypoints, and the pairs behind them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.extrinsics import KeypointDepths, MapExtrinsics
from webapp.core.reconstruction.pairs import PhotoPairs
from webapp.errors import IndexDamaged, StorageError
from webapp.files.localize.arrays import read_arrays, write_arrays, write_settled

FORMAT = 4
"""To be increased when the arrays change their meaning."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredPairs:
    pairs: PhotoPairs  # Their photos are indices into `contents`
    contents: list[str]  # SHA-256 of the photo files
    done: int  # The first `done` photos have been paired; a search for partners resumes after them
    key: str  # Identifies all else that the pairs depend on


@dataclass(frozen=True, slots=True, eq=False)
class StoredOrientations:
    """Orientations of p photos by content."""

    orientations: MapExtrinsics
    contents: list[str]
    position: NDArray[np.float64]  # (p, 2) float64. Positions of the photos at the time, map pixels.
    key: str  # Identifies all that the orientations depend on


_PAIRS = (
    "first",
    "second",
    "rotation",
    "translation",
    "trust",
    "parallax",
    "start",
    "row_first",
    "row_second",
    "ray_first",
    "ray_second",
)


_DEPTHS = ("photo", "row", "inverse_depth", "sigma")


def write_pairs(path: Path, stored: StoredPairs) -> None:
    """Replace the file. Raises StorageError."""
    arrays = {name: getattr(stored.pairs, name) for name in _PAIRS}
    meta = {"format": FORMAT, "key": stored.key, "done": stored.done, "contents": stored.contents}
    _make_folder(path)
    write_arrays(path, arrays, meta=meta)


def read_pairs(path: Path) -> StoredPairs | None:
    """Read the file; None if it is missing or unusable, so that it is recomputed."""
    try:
        arrays, meta = read_arrays(path, mapped=False)
        if meta["format"] != FORMAT:
            return None
        pairs = PhotoPairs(**{name: arrays[name] for name in _PAIRS})
        return StoredPairs(pairs, list(meta["contents"]), int(meta["done"]), str(meta["key"]))
    except (IndexDamaged, KeyError):
        return None


def write(path: Path, stored: StoredOrientations) -> None:
    """Replace the file. Raises StorageError."""
    found = stored.orientations
    arrays = {
        "rotation": found.rotation,
        "height": found.height,
        "trust": found.trust,
        "partner": found.partner,
        "position": stored.position,
        **{f"depth_{name}": getattr(found.depths, name) for name in _DEPTHS},
    }
    _make_folder(path)
    write_settled(path, arrays, meta={"format": FORMAT, "key": stored.key, "contents": stored.contents})


def read(path: Path) -> StoredOrientations | None:
    """Read the file; None if it is missing or unusable, so that it is recomputed."""
    try:
        arrays, meta = read_arrays(path, mapped=False)
        if meta["format"] != FORMAT:
            return None
        depths = KeypointDepths(**{name: arrays[f"depth_{name}"] for name in _DEPTHS})
        found = MapExtrinsics(
            arrays["rotation"], arrays["height"], arrays["trust"], depths, partner=arrays["partner"]
        )
        return StoredOrientations(found, list(meta["contents"]), arrays["position"], str(meta["key"]))
    except (IndexDamaged, KeyError):
        return None


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"the folder cannot be created: {error.strerror}", where=str(path.parent)
        ) from error
