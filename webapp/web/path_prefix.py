"""Refuses to answer below a path of a proxy: links, cookies and the service worker are of a host's root."""

from __future__ import annotations

from flask import Flask, request

from webapp.errors import UsageError

_HINT = "give it a host name or a port of its own: a proxy can pass maps.example.org, not example.org/maps"


def init_app(app: Flask) -> None:
    """Refuse requests that a proxy has taken from below a path."""
    app.before_request(_refuse_prefix)


def _refuse_prefix() -> None:
    prefix = request.headers.get("X-Forwarded-Prefix", request.script_root).strip().strip("/")
    if prefix:
        raise UsageError(f"Experience Map cannot be served below a path (/{prefix[:80]})", hint=_HINT)
