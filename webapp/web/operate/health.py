"""The health check: whether all that the server needs works, and nothing else about it."""

from __future__ import annotations

import shutil
from http import HTTPStatus
from typing import Any

from flask import Blueprint
from sqlalchemy import text

from webapp.errors import StorageError
from webapp.files.lock import any_alive
from webapp.web.context import library, public, settings

blueprint = Blueprint("health", __name__)


@blueprint.get("/healthz")
@public
def healthz() -> tuple[dict[str, Any], HTTPStatus]:
    """Answer 200 when all is well, 503 when something is not; needs no sign-in."""
    parts = {
        "database": _database_answers(),
        "disk": _disk_has_room(),
        "worker": any_alive(library().inner / "workers"),
    }
    states = {name: "ok" if well else "failing" for name, well in parts.items()}
    well = all(parts.values())
    status = HTTPStatus.OK if well else HTTPStatus.SERVICE_UNAVAILABLE
    return {"status": "ok" if well else "failing", **states}, status


def _database_answers() -> bool:
    try:
        with library().database.read() as session:
            session.execute(text("SELECT 1 FROM map LIMIT 1"))
    except StorageError:
        return False
    return True


def _disk_has_room() -> bool:
    """Return whether photos are still taken in."""
    try:
        return shutil.disk_usage(library().folder).free >= settings().upload.reserve_mb * 1e6
    except OSError:
        return False
