"""Stores the last evaluation of a map on its own photos, next to its index, for the web pages."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.evaluation.metrics import ReliabilityBin, reliability_bins
from webapp.errors import StorageError
from webapp.files.atomic import write_text
from webapp.files.listing import DERIVED
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation.types import Evaluation

FILE = "evaluation.json"
"""File in the map's folder `derived`, with the output of `expmap evaluate --self --json`."""


@dataclass(frozen=True, slots=True)
class Miss:
    """A photo whose first hypothesis was wrong or missing."""

    path: str  # Path relative to the map's folder
    error_px: float | None  # Error of the first hypothesis; None without one
    probability: float | None  # Probability of the first hypothesis


@dataclass(frozen=True, slots=True, eq=False)
class StoredEvaluation:
    figures: dict[str, Any]  # Output of `expmap evaluate --json` without the queries
    # (n,) float64. Errors of the first hypotheses, map pixels; infinite without a hypothesis.
    errors: NDArray[np.float64]
    reliability: tuple[ReliabilityBin, ...]
    misses: tuple[Miss, ...]  # Sorted by falling error, those without an answer last
    revision: int  # Revision of the evaluated map
    at: datetime  # Time of the evaluation, UTC


def keep(cfg: Path, evaluations: Sequence[Evaluation]) -> list[dict[str, Any]]:
    """Write an evaluation, replacing the previous one. Raises StorageError."""
    forms = [evaluate.to_json(one) for one in evaluations]
    write_text(_path(cfg), json.dumps(forms))
    return forms


def read(cfg: Path) -> tuple[StoredEvaluation, ...]:
    """Read the last evaluation; an empty tuple if there is none."""
    forms = read_forms(cfg)
    try:
        return tuple(_kept(form, _written(cfg)) for form in forms)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _unreadable() from error


def read_forms(cfg: Path) -> list[dict[str, Any]]:
    """Read the last evaluation as JSON objects; an empty list if there is none."""
    try:
        forms: list[dict[str, Any]] = json.loads(_path(cfg).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise _unreadable() from error
    return forms


def _written(cfg: Path) -> datetime:
    return datetime.fromtimestamp(_path(cfg).stat().st_mtime, UTC)


def _unreadable() -> StorageError:
    return StorageError("the evaluation of the map cannot be read", where=FILE, hint="evaluate the map again")


def _kept(form: dict[str, Any], at: datetime) -> StoredEvaluation:
    results = form["per_query"]
    errors = np.array([math.inf if r["error_px"] is None else r["error_px"] for r in results], np.float64)
    stated = np.array([_stated(r["answer"]) for r in results], np.float64)
    has = np.isfinite(stated)
    bins = reliability_bins(stated[has], errors[has] <= form["place_radius_px"])
    figures = {name: value for name, value in form.items() if name != "per_query"}
    misses = _misses(results, radius=form["place_radius_px"])
    return StoredEvaluation(figures, errors, bins, misses, form.get("map_revision", -1), at)


def _misses(results: list[dict[str, Any]], *, radius: float) -> tuple[Miss, ...]:
    found = []
    for result in results:
        error, stated = result["error_px"], _stated(result["answer"])
        if error is None or error > radius:
            found.append(Miss(result["path"], error, None if math.isnan(stated) else stated))
    return tuple(
        sorted(found, key=lambda miss: -math.inf if miss.error_px is None else miss.error_px, reverse=True)
    )


def _stated(answer: dict[str, Any]) -> float:
    first = next(iter(answer.get("hypotheses", ())), None)  # a photo that failed has none
    return math.nan if first is None else float(first["probability"])


def _path(cfg: Path) -> Path:
    return cfg.parent / DERIVED / FILE
