"""The calibration of a map's probabilities, stored next to its index, and the trials it is fitted to."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from webapp.core.hypotheses.calibration import EVIDENCE, Calibration
from webapp.errors import StorageError
from webapp.files import atomic
from webapp.files.sealed import sealed, unsealed

TrialRecord = dict[str, Any] | None
"""JSON values; None for a photo that cannot be used."""

FORMAT = 17
"""To be increased when the evidence of the slopes, or the radii, change their meaning."""

TRIALS_FORMAT = 14
"""To be increased when trials record something else; a change of `FORMAT` alone keeps existing trials."""


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    calibration: Calibration
    map_fov_deg: float | None  # The option for photos without a known field of view
    place_radius_px: float  # Distance within which a position counted as right
    photos: frozenset[str]  # A key per photo that changes with its content and, roughly, its position
    seconds: float  # Time that the calibration took
    # For two looks: time of the second one per photo, without feature extraction, on an idle machine.
    second_look_s: float = 0.0
    # Number of real queries among the photos that it was fitted on, and a digest of their list
    queries: int = 0
    queries_key: str = ""
    adopted: int = 0  # Number of photos in `adopted.py`'s list, some of which may not be in the index


def write(path: Path, stored: StoredCalibration) -> None:
    """Replace the file; its folder is created if missing. Raises StorageError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"the folder cannot be created: {error.strerror}", where=str(path.parent)
        ) from error
    raw = {"format": FORMAT, **asdict(stored), "photos": sorted(stored.photos)}
    atomic.write_bytes(path, sealed(raw))


def read(path: Path, *, numbers: int = EVIDENCE) -> StoredCalibration | None:
    """Read the file; None if it is missing or unusable, so that it is recomputed.

    Args:
        numbers: Number of evidence values of a place.
    """
    try:
        raw = unsealed(path.read_bytes())
        if raw["format"] != FORMAT or len(raw["calibration"]["slope"]) != numbers:
            return None
        fitted = {**raw["calibration"], "slope": tuple(map(float, raw["calibration"]["slope"]))}
        return StoredCalibration(
            calibration=Calibration(**fitted),
            map_fov_deg=raw["map_fov_deg"],
            place_radius_px=float(raw["place_radius_px"]),
            photos=frozenset(raw["photos"]),
            seconds=float(raw["seconds"]),
            second_look_s=float(raw["second_look_s"]),
            queries=int(raw.get("queries", 0)),
            queries_key=str(raw.get("queries_key", "")),
            adopted=int(raw.get("adopted", 0)),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


@contextmanager
def recorded_trials(
    path: Path, key: str
) -> Iterator[tuple[dict[int, TrialRecord], Callable[[int, TrialRecord], None]]]:
    """Yield the trials recorded under the same key, and a function that appends another photo's trial.

    Trials survive if the process is killed; the file is kept, for a joint calibration of several looks.
    Raises StorageError.
    """
    known = _read(path, key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Rewritten to drop an incomplete last line.
        atomic.write_text(path, "".join(_line(row) for row in (key, *([n, t] for n, t in known.items()))))
        with path.open("a", encoding="utf-8") as file:

            def append(number: int, trial: TrialRecord) -> None:
                file.write(_line([number, trial]))
                file.flush()

            yield known, append
    except OSError as error:
        raise StorageError(f"the file cannot be written: {error.strerror}", where=str(path)) from error


def _line(row: object) -> str:
    return json.dumps(row) + "\n"


def _read(path: Path, key: str) -> dict[int, TrialRecord]:
    found: dict[int, TrialRecord] = {}
    try:
        first, *lines = path.read_text(encoding="utf-8").splitlines()
        if json.loads(first) != key:
            return {}
        for line in lines:
            number, trial = json.loads(line)
            found[int(number)] = trial
    except (OSError, ValueError):
        pass  # no file, or an incomplete last line of a killed writer: the lines before it are used
    return found
