"""The job `satellite-pyramid`: tiles of a large satellite image, for display."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.tasks.satellite import display


def run(context: Context) -> dict[str, Any]:
    """Make the tiles of the map's present image, where it has none yet."""
    made = display.make_tiles(
        context.library, context.map().id, settings=context.settings, progress=context.progress
    )
    return {"tiles": made}
