"""An id, a log line and a span for each request.

The id is that of the header `X-Request-ID`, which a proxy may have set, or a new one. It is in the response,
and in all log lines that are written for the request.

The log has the pattern of the route instead of the path, and the map's slug, so that it contains neither
secret links nor other data from clients.
"""

from __future__ import annotations

import logging
import re
import secrets
import time
from contextlib import ExitStack

from flask import Flask, Response, g, request

from webapp.logs import REQUESTS, at_work
from webapp.telemetry import span

_log = logging.getLogger(REQUESTS)

_HEADER = "X-Request-ID"
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


def init_app(app: Flask) -> None:
    app.before_request(_begin)
    app.after_request(_end)
    app.teardown_request(_leave)


def _begin() -> None:
    g.expmap_begun = time.perf_counter()
    given = request.headers.get(_HEADER, "")
    g.expmap_request_id = given if _ID.fullmatch(given) else secrets.token_hex(8)
    g.expmap_at_work = stack = ExitStack()
    stack.enter_context(at_work(request=g.expmap_request_id))
    route = None if request.url_rule is None else request.url_rule.rule
    name = f"{request.method} {route or 'nowhere'}"
    g.expmap_span = stack.enter_context(
        span(name, headers=dict(request.headers), request=g.expmap_request_id)
    )


def _leave(_error: BaseException | None) -> None:
    stack = g.pop("expmap_at_work", None)
    if stack is not None:
        stack.close()


def _end(response: Response) -> Response:
    if "expmap_request_id" in g:
        response.headers[_HEADER] = g.expmap_request_id
    if g.get("expmap_span") is not None:
        g.expmap_span.set_attribute("http.response.status_code", response.status_code)
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
