"""Small helpers for pages with forms."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

from flask import redirect, request, url_for
from werkzeug.wrappers import Response


def text(name: str) -> str:
    """Give a field of the form; empty when it was not sent."""
    return request.form.get(name, "")


def own_path(address: str | None) -> str | None:
    """Give path and query of an address that a client sent, so that it can lead nowhere else.

    Returns
    -------
    str or None
        None for what is no path of this site.
    """
    parts = urlsplit((address or "").replace("\\", "/"))
    if not parts.path.startswith("/") or parts.path.startswith("//"):
        return None
    return f"{parts.path}?{parts.query}" if parts.query else parts.path


def back(endpoint: str, **values: Any) -> Response:
    """Lead to a page after a form was done, so that reloading it does nothing twice."""
    return redirect(url_for(endpoint, **values), code=303)
