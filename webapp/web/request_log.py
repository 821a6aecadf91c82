"""A line of the log for each request: what was asked for, by which account, and how it ended.

Addresses are logged as the routes have them, without what varies but the map: a link that lets somebody in is
never part of it, nor is anything that a client wrote.
"""

from __future__ import annotations

import logging
import time

from flask import Flask, Response, g, request

from webapp.jobs.logs import REQUESTS

_log = logging.getLogger(REQUESTS)


def init_app(app: Flask) -> None:
    """Log every request."""
    app.before_request(_begin)
    app.after_request(_end)


def _begin() -> None:
    g.expmap_begun = time.perf_counter()


def _end(response: Response) -> Response:
    if not _log.isEnabledFor(logging.INFO):
        return response
    route = None if request.url_rule is None else request.url_rule.rule
    account = g.get("expmap_account")
    begun = g.get("expmap_begun")
    fields = {
        "event": "request",
        "method": request.method,
        "route": route,
        "map": (request.view_args or {}).get("slug") if response.status_code < 400 else None,
        "status": response.status_code,
        "ms": None if begun is None else round((time.perf_counter() - begun) * 1000, 1),
        "bytes": response.content_length,
        "account": None if account is None else account.id,
    }
    level = logging.ERROR if response.status_code == 500 else logging.INFO
    _log.log(level, "%s %s %d", request.method, route, response.status_code, extra={"fields": fields})
    return response
