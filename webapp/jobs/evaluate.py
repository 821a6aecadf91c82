"""The job `evaluate`: a map's own photos, each localized as if it were not on the map."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.store.maps import maps
from webapp.tasks.localize import evaluate, stored_evaluation
from webapp.tasks.localize.calibrate import MOST_PHOTOS
from webapp.tasks.localize.evaluation_types import EvaluateOptions
from webapp.tasks.localize.open_map import OpenOptions
from webapp.tasks.localize.pipeline import open_pipeline, with_hidden_photos
from webapp.tasks.maps import export


def run(context: Context) -> dict[str, Any]:
    """Evaluate, keep the whole report beside the index, and give its figures.

    The argument `limit` takes so many photos, evenly spread over the map.
    """
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    cfg = library.cfg(record.slug)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    limit: int | None = context.arguments.get("limit")
    context.progress.plan(0, min(placed, MOST_PHOTOS), 2 * min(placed, limit or placed))
    context.progress.note("preparing the map")
    localizer = open_pipeline(cfg, OpenOptions(), settings=context.settings, progress=context.progress)
    done = evaluate.evaluate_self(
        with_hidden_photos(localizer),
        map_folder=cfg.parent,
        options=EvaluateOptions(limit=limit),
        progress=context.progress,
    )
    forms = stored_evaluation.keep(cfg, done)
    return {form["scheme"]: {name: form[name] for name in form if name != "per_query"} for form in forms}
