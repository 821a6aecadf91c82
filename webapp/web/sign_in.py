"""Signing in and out."""

from __future__ import annotations

from flask import Blueprint

from webapp.web.access import public

blueprint = Blueprint("sign_in", __name__)


@blueprint.get("/sign-in")
@public
def form() -> str:
    """Ask for name and password."""
    return "sign in"
