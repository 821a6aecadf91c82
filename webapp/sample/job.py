"""The job `sample`: the sample map in a new library."""

from __future__ import annotations

import shutil
from dataclasses import replace
from typing import Any

from sqlalchemy import select

from webapp.errors import UsageError
from webapp.jobs.context import Context
from webapp.sample import make
from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map

SLUG = "sample"


def make_sample_map(context: Context) -> dict[str, Any]:
    """Make the sample and register it, unless it exists already."""
    if context.account_id is None:
        raise UsageError("the sample map needs an owner")
    library = context.library
    settings = replace(context.settings, library=library.folder)
    for half_made in library.folder.glob(f".{SLUG}.*.tmp"):
        shutil.rmtree(half_made)  # left by a killed worker
    make.make_sample(None, settings=settings, progress=context.progress)
    with library.database.read() as session:
        there = session.scalars(select(MapRecord.id).where(MapRecord.slug == SLUG)).first()
    if there is None:
        adopt_map.adopt_map(
            library, SLUG, account_id=context.account_id, settings=settings, progress=context.progress
        )
    return {"map": SLUG}
