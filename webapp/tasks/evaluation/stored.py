"""The last evaluation of a map by its own photos, kept next to its index for the pages."""

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

from webapp.core.evaluation.metrics import reliability_bins
from webapp.core.evaluation.types import ReliabilityBin
from webapp.errors import StorageError
from webapp.files.atomic import write_text
from webapp.files.listing import DERIVED
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation.types import Evaluation

FILE = "evaluation.json"
"""In the map's folder `derived`: what `expmap evaluate --self --json` prints."""


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """One scheme of the evaluation.

    Attributes
    ----------
    figures : dict
        As `expmap evaluate --json` prints them, without the queries.
    errors : (n,) float64
        Of the first hypotheses, map pixels; infinite without a hypothesis.
    revision : int
        Of the map that was evaluated.
    at : datetime
        When it was done, UTC.
    """

    figures: dict[str, Any]
    errors: NDArray[np.float64]
    reliability: tuple[ReliabilityBin, ...]
    revision: int
    at: datetime


def keep(cfg: Path, evaluations: Sequence[Evaluation]) -> list[dict[str, Any]]:
    """Write an evaluation over the one before.

    Returns
    -------
    list of dict
        The objects that were written.

    Raises
    ------
    StorageError
    """
    forms = [evaluate.to_json(one) for one in evaluations]
    write_text(_path(cfg), json.dumps(forms))
    return forms


def read(cfg: Path) -> tuple[Kept, ...]:
    """Read the last evaluation; nothing where there is none.

    Raises
    ------
    StorageError
        The file cannot be read.
    """
    path = _path(cfg)
    try:
        at = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        return tuple(_kept(form, at) for form in json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StorageError(
            "the evaluation of the map cannot be read", where=FILE, hint="evaluate the map again"
        ) from error


def _kept(form: dict[str, Any], at: datetime) -> Kept:
    results = form["per_query"]
    errors = np.array([math.inf if r["error_px"] is None else r["error_px"] for r in results], np.float64)
    stated = np.array([_stated(r["answer"]) for r in results], np.float64)
    has = np.isfinite(errors)
    bins = reliability_bins(stated[has], errors[has] <= form["place_radius_px"])
    figures = {name: value for name, value in form.items() if name != "per_query"}
    return Kept(figures, errors, bins, form.get("map_revision", -1), at)


def _stated(answer: dict[str, Any]) -> float:
    first = next(iter(answer.get("hypotheses", ())), None)  # a photo that failed has none
    return math.nan if first is None else float(first["probability"])


def _path(cfg: Path) -> Path:
    return cfg.parent / DERIVED / FILE
