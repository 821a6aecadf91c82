"""The job `index`: a map's index and the calibration of its probabilities, up to date."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.store.maps import maps
from webapp.tasks.localize import build_map
from webapp.tasks.localize.calibrate import MOST_PHOTOS
from webapp.tasks.localize.map_cache import MethodChoice
from webapp.tasks.localize.open_map import OpenOptions
from webapp.tasks.maps import export

_NAMED = 100
"""At most so many photos that could not be used are named in the result."""


def run(context: Context) -> dict[str, Any]:
    """Build, as `expmap build` does; what is finished when it is interrupted stays finished.

    The arguments `features` and `method` name others than the library's own.
    """
    usual = MethodChoice()
    way = MethodChoice(
        context.arguments.get("method", usual.method), context.arguments.get("features") or usual.features
    )
    method, features = way.resolved()
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    by_network = [placed] if method == "thorough" else []
    context.progress.plan(placed, placed, *by_network, min(placed, MOST_PHOTOS))
    context.progress.note("describing photos")
    report = build_map.build_map(
        library.cfg(record.slug),
        OpenOptions(method=method, features=features),
        settings=context.settings,
        progress=context.progress,
    )
    failed = [{"id": id, "photo": photo, "reason": reason} for id, photo, reason in report.index.failed]
    return {
        "photos": report.index.photos,
        "computed": report.index.extracted,
        "failed": failed[:_NAMED],
        "features": report.features,
        "method": method,
        "seconds": round(report.index.seconds + (report.calibration_seconds or 0.0), 3),
    }
