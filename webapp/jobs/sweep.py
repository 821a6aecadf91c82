"""Deletes what a process that was killed has left behind."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from datetime import timedelta
from functools import partial

from sqlalchemy import select

from webapp.errors import ExpMapError
from webapp.jobs.kinds import Sweep
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.operate import sweep_uploads
from webapp.tasks.satellite import unused

_log = logging.getLogger(__name__)


def clean(library: Library, settings: Settings, *, more: Sequence[Sweep] = ()) -> None:
    """Delete what interrupted uploads and deletions have left behind."""
    with library.database.read() as session:
        ids = session.scalars(select(MapRecord.id)).all()
    sweeps: list[Sweep] = [*more, partial(sweep_uploads.sweep_uploads, settings=settings)]
    sweeps += [partial(sweep_uploads.sweep_orphans, map_id=id) for id in ids]
    keep = timedelta(hours=settings.upload.keep_hours)
    sweeps += [partial(unused.sweep, map_id=id, keep=keep) for id in ids]
    for sweep in sweeps:
        try:
            sweep(library)
        except (ExpMapError, OSError) as error:
            _log.warning("what was left behind could not be deleted: %s", error)
