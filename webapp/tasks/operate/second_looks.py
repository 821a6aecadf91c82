"""Gives the maps of a library their second index once the models of the second look are installed."""

from __future__ import annotations

from datetime import UTC, datetime

from sqlalchemy import select

from webapp.files.localize.models import MODELS, models_folder
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.operate.models import SECOND_LOOK, missing_second_look


def queue_second_looks(library: Library, settings: Settings) -> int:
    """Queue the index job of each map whose last one ended before the models were installed.

    An index that is up to date is not built again, so a job too many does no harm.

    Returns:
        Number of maps.
    """
    if SECOND_LOOK[0] in missing_second_look(settings) or settings.retrieval.budget_s == 0.0:
        return 0
    since, count = _installed_at(settings), 0
    with library.database.write() as session:
        for id in session.scalars(select(MapRecord.id).where(MapRecord.binned_at.is_(None))).all():
            last = jobs.newest(session, id, kind=INDEX_JOB, key="")
            if last is not None and last.ended_at is not None and last.ended_at < since:
                jobs.enqueue(session, INDEX_JOB, map_id=id)
                count += 1
    return count


def _installed_at(settings: Settings) -> datetime:
    """Return when the last model of the second look was installed."""
    folder = models_folder(settings.models)
    paths = [folder / file.name for name in SECOND_LOOK for file in MODELS[name]]
    newest = max((path.stat().st_mtime for path in paths if path.is_file()), default=0.0)
    return datetime.fromtimestamp(newest, UTC)
