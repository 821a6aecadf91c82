"""Finds the weak places of a map by localizing its own photos."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Any

from webapp.core.hypotheses.model import Answer
from webapp.core.mapmodel.health import judge
from webapp.errors import StorageError
from webapp.files.atomic import write_text
from webapp.files.listing import DERIVED
from webapp.files.localize import queries_csv
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.evaluation.types import EvaluateOptions
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

LIMIT = 200
"""Maximum number of photos used, evenly spread over the map."""

_FILE = "health.json"
_VERSION = 1


def find_weak_places(
    cfg: Path, *, settings: Settings, progress: Progress, options: OpenOptions | None = None
) -> dict[str, Any]:
    """Localize photos of the map, each hidden from it, and store an assessment of each photo.

    Raises MapError, UsageError, StorageError, Cancelled.

    Returns:
        As from `read_health`.
    """
    options = options or OpenOptions(method="verified")
    localizer = open_pipeline(cfg, options, settings=settings, progress=progress)
    done = evaluate.evaluate_self(
        with_hidden_photos(localizer),
        map_folder=cfg.parent,
        options=EvaluateOptions(limit=LIMIT),
        progress=progress,
    )
    tried = queries_csv.select(localizer.map.experiences, LIMIT)
    answers: dict[int, list[Answer]] = defaultdict(list)
    for evaluation in done:
        for e, result in zip(tried, evaluation.results, strict=True):
            if result.answer is not None:
                answers[e.id].append(result.answer)
    judged = judge(localizer.map.experiences, answers, place_radius_px=localizer.place_radius_px)
    content = {
        "version": _VERSION,
        "revision": localizer.map.revision,
        "place_radius_px": localizer.place_radius_px,
        "photos": [asdict(photo) for photo in judged],
    }
    write_text(_path(cfg), json.dumps(content))
    return content


def read_health(cfg: Path) -> dict[str, Any] | None:
    """Read the last result of `find_weak_places`.

    Returns:
        `revision` of the evaluated map, `place_radius_px`, and `photos`: `id`, `state` (`confusable`,
            `lonely`, `one-direction` or `good`), `taken_for`, `probability`. None if there is no file of this
            version.
    """
    try:
        content: dict[str, Any] = json.loads(_path(cfg).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StorageError(
            "the survey of the map cannot be read", where=_FILE, hint="run the survey again"
        ) from error
    return content if content.get("version") == _VERSION else None


def _path(cfg: Path) -> Path:
    return cfg.parent / DERIVED / _FILE
