"""The job that fetches models, as `expmap models fetch` does."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.tasks.operate import models
from webapp.tasks.operate.models import queue_second_looks


def fetch_models(context: Context) -> dict[str, Any]:
    """Fetch the models named by the argument `models` that are missing; then maps get their second index."""
    settings = context.settings
    wanted = models.missing(context.arguments["models"], settings=settings)
    for name in wanted:
        context.progress.note("fetching a model")
        models.fetch(models.choose_file(name, None), None, settings=settings, progress=context.progress)
    return {"fetched": wanted, "maps": queue_second_looks(context.library, settings)}
