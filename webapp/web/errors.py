"""Error responses: the mapping of errors to HTTP statuses, and their common form in JSON.

::

    {"error": {"code": "not_found", "message": "...", "hint": "..." or null, "where": "..." or null}}
"""

from __future__ import annotations

import re
from http import HTTPStatus
from pathlib import Path
from typing import Any

from apiflask.exceptions import HTTPError
from flask import Flask, Response, jsonify, redirect, render_template, request, url_for
from flask_babel import gettext as _
from flask_limiter.errors import RateLimitExceeded
from flask_wtf.csrf import CSRFError
from werkzeug.exceptions import HTTPException
from werkzeug.wrappers import Response as BaseResponse

from webapp.errors import (
    Cancelled,
    Conflict,
    ExpMapError,
    IndexDamaged,
    InputError,
    MapError,
    MissingPart,
    NotAllowed,
    NotFound,
    NotReady,
    NotSignedIn,
    ProcessLost,
    RetryLater,
    StorageError,
    TooMany,
    UsageError,
)
from webapp.files.atomic import storage_error, takes_nothing
from webapp.web import language
from webapp.web.accounts.sessions import assume_no_caller, is_api

_TABLE: tuple[tuple[type[ExpMapError], HTTPStatus], ...] = (
    (UsageError, HTTPStatus.BAD_REQUEST),
    (NotFound, HTTPStatus.NOT_FOUND),
    (NotSignedIn, HTTPStatus.UNAUTHORIZED),
    (NotAllowed, HTTPStatus.FORBIDDEN),
    (TooMany, HTTPStatus.TOO_MANY_REQUESTS),
    (RetryLater, HTTPStatus.SERVICE_UNAVAILABLE),
    (Conflict, HTTPStatus.CONFLICT),
    (NotReady, HTTPStatus.CONFLICT),
    (MapError, HTTPStatus.UNPROCESSABLE_ENTITY),
    (InputError, HTTPStatus.UNPROCESSABLE_ENTITY),
    (Cancelled, HTTPStatus.CONFLICT),
    (StorageError, HTTPStatus.INSUFFICIENT_STORAGE),
    (IndexDamaged, HTTPStatus.SERVICE_UNAVAILABLE),
    (MissingPart, HTTPStatus.UNPROCESSABLE_ENTITY),
    (ProcessLost, HTTPStatus.SERVICE_UNAVAILABLE),
)


def status_of(error: ExpMapError) -> HTTPStatus:
    """Return the status of an error; a conflict is a 412 if the request has `If-Match`."""
    if isinstance(error, Conflict) and "If-Match" in request.headers:
        return HTTPStatus.PRECONDITION_FAILED
    return next(
        (status for kind, status in _TABLE if isinstance(error, kind)), HTTPStatus.INTERNAL_SERVER_ERROR
    )


def as_json(error: ExpMapError) -> dict[str, Any]:
    """Return an error in the common form of the API, without the outer `error`."""
    where = error.where
    if where is not None and isinstance(error, StorageError):
        where = where.replace("\\", "/").rpartition("/")[2]  # do not disclose paths of the server
    body = _shape(_code(type(error).__name__), language.translate(error.message), where=where)
    return body | {"hint": None if error.hint is None else language.translate(error.hint)}


def extra_headers(error: ExpMapError) -> dict[str, str]:
    """Return the headers that belong to the status of an error."""
    if isinstance(error, RetryLater):
        return {"Retry-After": str(error.wait_s)}
    return {"WWW-Authenticate": "Bearer"} if isinstance(error, NotSignedIn) else {}


def init_app(app: Flask) -> None:
    app.register_error_handler(ExpMapError, _own)
    app.register_error_handler(HTTPError, _of_apiflask)
    app.register_error_handler(CSRFError, _csrf)
    app.register_error_handler(RateLimitExceeded, _rate)
    app.register_error_handler(HTTPException, _http)
    app.register_error_handler(OSError, _of_system)


def _own(error: ExpMapError) -> BaseResponse:
    if isinstance(error, NotSignedIn) and not is_api():
        there = request.full_path.rstrip("?") if request.method == "GET" else None
        return redirect(url_for("sign_in.form", next=there))
    if isinstance(error, StorageError):
        assume_no_caller()
    response = _answer(as_json(error), status_of(error))
    response.headers.update(extra_headers(error))
    return response


def _of_system(error: OSError) -> BaseResponse:
    """Answer an error of a full or read-only disk; any other OSError is a bug."""
    if not takes_nothing(error):
        raise error
    return _own(storage_error(error, where=Path(error.filename or "").name))


def _of_apiflask(error: HTTPError) -> Response:
    """Answer a request that violates its schema, with the first problem found."""
    where, message = _first(error.detail)
    status = HTTPStatus(error.status_code)
    body = message or error.message or status.phrase.lower()
    return _answer(_shape(_code(status.phrase), body, where=where), status)


def _first(detail: Any, path: tuple[str, ...] = ()) -> tuple[str | None, str | None]:
    """Return the field and the text of the first message in marshmallow's errors."""
    if isinstance(detail, dict) and detail:
        key, inner = next(iter(detail.items()))
        return _first(inner, (*path, str(key)))
    if isinstance(detail, list) and detail:
        return _first(detail[0], path)
    return (".".join(path) or None, detail) if isinstance(detail, str) else (None, None)


def _csrf(_error: CSRFError) -> Response:
    body = _shape("csrf", _("this page has expired"), hint=_("reload the page and try again"))
    return _answer(body, HTTPStatus.BAD_REQUEST)


def _rate(error: RateLimitExceeded) -> Response:
    body = _shape("too_many", _("too many requests in a short time"), hint=_("wait a minute"))
    response = _answer(body, HTTPStatus.TOO_MANY_REQUESTS)
    response.headers["Retry-After"] = str(error.limit.limit.get_expiry())
    return response


def _http(error: HTTPException) -> BaseResponse:
    """Answer an HTTP error of Flask; this includes unexpected exceptions, which are already logged."""
    if error.response is not None or (error.code or 500) < 400:
        return Response.force_type(error.get_response(), request.environ)
    status = HTTPStatus(error.code or 500)
    response = _answer(_in_words(status), status)
    for name, value in error.get_headers(request.environ):
        if name in ("Allow", "Retry-After"):
            response.headers[name] = value
    return response


def _in_words(status: HTTPStatus) -> dict[str, Any]:
    """Return the error body for a status that Flask itself raises."""
    smaller = _("send less at once") if request.is_json else _("send a smaller file")
    words: dict[int, tuple[str, str | None]] = {
        400: (_("the request is not well-formed"), _("reload the page and try again")),
        404: (_("page not found"), None),
        405: (_("this cannot be done here"), None),
        413: (_("this is too large"), smaller),
        415: (_("the request is of the wrong type"), None),
        500: (_("internal error"), _("try again; the details are in the server's log")),
    }
    message, hint = words.get(status.value, (status.phrase.lower(), None))
    return _shape(_code(status.phrase), message, hint=hint)


def _code(name: str) -> str:
    """Convert the name of a class or a status to an error code."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|\W+", "_", name).lower()


def _shape(code: str, message: str, *, hint: str | None = None, where: str | None = None) -> dict[str, Any]:
    return {"code": code, "message": message, "hint": hint, "where": where}


def _answer(body: dict[str, Any], status: HTTPStatus) -> Response:
    if is_api():
        response = jsonify(error=body)
    else:
        response = Response(render_template("operate/error.html", error=body, status=status.value))
    response.status_code = status.value
    return response
