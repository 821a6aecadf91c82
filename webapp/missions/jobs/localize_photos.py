"""The job `mission-fix`: photos of a mission, localized on its map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from webapp.errors import IndexDamaged, NotReady
from webapp.jobs import index
from webapp.jobs.context import Context
from webapp.missions.tasks import localize_photos
from webapp.tasks.localize.map_cache import MapCache


def run(context: Context) -> dict[str, Any]:
    """Localize what waits on the mission that the argument `mission` names; what is done stays so."""
    try:
        return _run(context)
    except (NotReady, IndexDamaged):
        context.progress.note("building the index of the map")
        index.run(replace(context, arguments={}))
        return _run(context)


def _run(context: Context) -> dict[str, Any]:
    return localize_photos.run(
        context.library,
        int(context.arguments["mission"]),
        map_cache=MapCache(context.library, context.settings),
        settings=context.settings,
        write=context.write,
        progress=context.progress,
    )
