"""Tells whoever watches the server that it answers and reaches its database."""

from __future__ import annotations

from flask import Blueprint
from sqlalchemy import text

from webapp import __version__
from webapp.web.access import public
from webapp.web.context import library

blueprint = Blueprint("health", __name__)


@blueprint.get("/healthz")
@public
def healthz() -> dict[str, str]:
    """Answer without a sign-in; a database that fails makes it a 5xx."""
    with library().database.read() as session:
        session.execute(text("SELECT 1"))
    return {"status": "ok", "version": __version__}
