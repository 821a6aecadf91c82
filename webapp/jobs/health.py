"""The job `health`: which photos of a map look alike, stand alone, or show one side only."""

from __future__ import annotations

from collections import Counter
from typing import Any

from webapp.jobs.context import Context
from webapp.store.maps import maps
from webapp.tasks.localize.calibrate import MOST_PHOTOS
from webapp.tasks.maps import export, health


def run(context: Context) -> dict[str, Any]:
    """Find it out, keep it beside the index, and count the states."""
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    context.progress.plan(0, min(placed, MOST_PHOTOS), 2 * min(placed, health.LIMIT))
    found = health.run(library.cfg(record.slug), settings=context.settings, progress=context.progress)
    return dict(Counter(photo["state"] for photo in found["photos"]))
