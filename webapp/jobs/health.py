"""The job `health`: which photos of a map look alike, stand alone, or show one side only."""

from __future__ import annotations

from collections import Counter
from typing import Any

from webapp.jobs.kinds import Context
from webapp.store import maps
from webapp.tasks import library_export, map_health
from webapp.tasks.calibrate import MOST_PHOTOS


def run(context: Context) -> dict[str, Any]:
    """Find it out, keep it beside the index, and count the states."""
    library, record = context.library, context.map()
    library_export.run(library, record.id)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    context.progress.plan(0, min(placed, MOST_PHOTOS), 2 * min(placed, map_health.LIMIT))
    found = map_health.run(library.cfg(record.slug), settings=context.settings, progress=context.progress)
    return dict(Counter(photo["state"] for photo in found["photos"]))
