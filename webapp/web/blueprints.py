"""All blueprints of the application: a line each for its import and its place."""

from __future__ import annotations

from flask import Blueprint

from webapp.web.health import blueprint as health
from webapp.web.sign_in import blueprint as sign_in

BLUEPRINTS: tuple[Blueprint, ...] = (
    health,
    sign_in,
)  # fmt: skip
