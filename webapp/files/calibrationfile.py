"""The calibration of a map's probabilities, beside its index."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path

from webapp.core.hypotheses.calibration import EVIDENCE, Calibration
from webapp.errors import StorageError
from webapp.files import atomic

FORMAT = 1

_PREFIX = 8
"""Characters of a content hash that are enough to tell whether a map has changed much."""


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A calibration and what it was made from.

    Attributes
    ----------
    calibration : Calibration
    map_fov_deg : float or None
        The option for photos without a known field of view.
    contents : frozenset of str
        First characters of the SHA-256 of the map's photos.
    seconds : float
        It took.
    """

    calibration: Calibration
    map_fov_deg: float | None
    contents: frozenset[str]
    seconds: float


def prefixes(contents: Collection[str]) -> frozenset[str]:
    """Shorten content hashes to what is stored."""
    return frozenset(c[:_PREFIX] for c in contents)


def write(path: Path, stored: StoredCalibration) -> None:
    """Replace the file; its folder is made when missing.

    Raises
    ------
    StorageError
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"the folder cannot be made: {error.strerror}", where=str(path.parent)) from error
    raw = {"format": FORMAT, **asdict(stored), "contents": sorted(stored.contents)}
    atomic.write_text(path, json.dumps(raw, sort_keys=True))


def read(path: Path) -> StoredCalibration | None:
    """Read the file; None when there is none that this program can use, so that it is made anew."""
    try:
        raw = json.loads(path.read_bytes())
        if raw["format"] != FORMAT or len(raw["calibration"]["slope"]) != EVIDENCE:
            return None
        fitted = {**raw["calibration"], "slope": tuple(map(float, raw["calibration"]["slope"]))}
        return StoredCalibration(
            Calibration(**fitted), raw["map_fov_deg"], frozenset(raw["contents"]), float(raw["seconds"])
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
