"""The calibration of a map's probabilities, beside its index."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from webapp.core.hypotheses.calibration import EVIDENCE, Calibration
from webapp.errors import StorageError
from webapp.files import atomic

FORMAT = 9
"""Another one where the evidence that the slopes belong to means something else."""


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A calibration and what it was made from.

    Attributes
    ----------
    map_fov_deg : float or None
        The option for photos without a known field of view.
    place_radius_px : float
        What counted as right.
    photos : frozenset of str
        For each photo a word that changes with its content and, roughly, its place.
    seconds : float
        It took.
    """

    calibration: Calibration
    map_fov_deg: float | None
    place_radius_px: float
    photos: frozenset[str]
    seconds: float


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
    raw = {"format": FORMAT, **asdict(stored), "photos": sorted(stored.photos)}
    atomic.write_text(path, json.dumps(raw, sort_keys=True))


def read(path: Path) -> StoredCalibration | None:
    """Read the file; None when there is none that this program can use, so that it is made anew."""
    try:
        raw = json.loads(path.read_bytes())
        if raw["format"] != FORMAT or len(raw["calibration"]["slope"]) != EVIDENCE:
            return None
        fitted = {**raw["calibration"], "slope": tuple(map(float, raw["calibration"]["slope"]))}
        return StoredCalibration(
            calibration=Calibration(**fitted),
            map_fov_deg=raw["map_fov_deg"],
            place_radius_px=float(raw["place_radius_px"]),
            photos=frozenset(raw["photos"]),
            seconds=float(raw["seconds"]),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None
