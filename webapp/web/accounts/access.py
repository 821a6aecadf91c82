"""Nobody gets in without a sign-in, except where a view says that it is for everyone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from flask import Flask, current_app, request

from webapp.web import context

View = TypeVar("View", bound=Callable[..., Any])

_MARK = "expmap_public"
_PUBLIC_ENDPOINTS = frozenset({"static", "openapi.spec"})
"""That libraries make, and that hold nothing of anybody."""


def public(view: View) -> View:
    """Mark a view as open to everyone; put it right below the route."""
    setattr(view, _MARK, True)
    return view


def is_public(view: Callable[..., Any]) -> bool:
    """Tell whether a view is open to everyone."""
    return bool(getattr(view, _MARK, False))


def init_app(app: Flask) -> None:
    """Have every request checked before anything of its body is read."""
    app.before_request(_check)


def _check() -> None:
    endpoint = request.endpoint
    if endpoint is None or endpoint in _PUBLIC_ENDPOINTS:
        return
    if not is_public(current_app.view_functions[endpoint]):
        context.account()
