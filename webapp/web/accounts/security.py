"""Security of all requests and responses: headers, cookies and their key, CSRF, rate limits."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

from flask import Flask, Response, current_app, g, has_request_context, request, session
from flask.sessions import SecureCookieSessionInterface
from flask_limiter import Limiter
from flask_wtf.csrf import CSRFError, CSRFProtect, validate_csrf
from itsdangerous import SignatureExpired, TimestampSigner, URLSafeTimedSerializer

from webapp.web import context
from webapp.web.accounts.sessions import bearer, is_api
from webapp.web.counting import storage_address
from webapp.web.state import KEY, settings

_PAGE_FORM_BYTES = 1_000_000
"""Limit of the forms of pages; files are sent to the API."""

_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), geolocation=(self), microphone=(), payment=(), usb=()",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_ONE_YEAR_S = 365 * 24 * 3600
_csrf = CSRFProtect()


def allow_images(*origins: str) -> None:
    """Allow the page of this request to load images from other origins, such as map tiles."""
    g.image_origins = (*g.get("image_origins", ()), *origins)


def allow_inline_script(text: str) -> None:
    """Allow this inline script in the page of this request: an import map cannot be a file."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    g.inline_scripts = (*g.get("inline_scripts", ()), f"'sha256-{digest}'")


def allow_framing() -> None:
    """Allow other sites to frame the page of this request, which must not act on behalf of a user."""
    g.framable = True


def init_app(app: Flask) -> None:
    """Register the checks of requests and the headers of responses."""
    app.config.update(
        SESSION_COOKIE_NAME="expmap",
        SESSION_COOKIE_HTTPONLY=True,
        SESSION_COOKIE_SAMESITE="Lax",
        WTF_CSRF_CHECK_DEFAULT=False,  # `_protect` checks, before the body is read
        WTF_CSRF_TIME_LIMIT=None,  # as long as the session: pages stay open for days
    )
    app.session_interface = _Sessions()
    _limit(app)
    context.init_app(app)
    _csrf.init_app(app)
    app.before_request(_protect)
    app.after_request(_add_headers)


class _Signer(TimestampSigner):
    """Accepts what was signed before the clock was set back: by default this would end all sessions."""

    def unsign(self, signed_value: Any, max_age: int | None = None, return_timestamp: bool = False) -> Any:
        value, signed_at = super().unsign(signed_value, return_timestamp=True)
        age_s = self.get_timestamp() - int(signed_at.timestamp())
        if max_age is not None and abs(age_s) > max_age:
            raise SignatureExpired(f"signed {age_s} s ago", payload=value, date_signed=signed_at)
        return (value, signed_at) if return_timestamp else value


class _Sessions(SecureCookieSessionInterface):
    def get_signing_serializer(self, app: Flask) -> URLSafeTimedSerializer | None:
        serializer = super().get_signing_serializer(app)
        if serializer is not None:
            serializer.signer = _Signer
        return serializer

    def get_cookie_secure(self, app: Flask) -> bool:
        """Restrict the cookie to https if the request was made over https."""
        return has_request_context() and request.is_secure


def _limit(app: Flask) -> None:
    address, options = storage_address(app.extensions[KEY].library.database)
    limiter = Limiter(
        _who,
        app=app,
        storage_uri=address,
        storage_options=options,
        application_limits=[_requests_per_minute],
    )
    limiter.request_filter(lambda: not is_api())


def _requests_per_minute() -> str:
    return f"{settings().web.requests_per_minute} per minute"


def _who() -> str:
    """Return the key of the rate limit: account id and epoch of the signed session, else the IP address."""
    return str(session.get("_user_id") or request.remote_addr)


def _protect() -> None:
    """Reject cross-site request forgery."""
    if request.method in _SAFE or bearer() is not None:
        return
    if is_api() and _takes_no_session():
        return
    if not is_api():
        request.max_content_length = _PAGE_FORM_BYTES
        _csrf.protect()
        return
    try:
        validate_csrf(request.headers.get("X-CSRFToken"))
    except ValueError as error:
        raise CSRFError(str(error)) from error


def _takes_no_session() -> bool:
    """Return whether the endpoint is public, so that a session gives no additional rights."""
    view = current_app.view_functions.get(request.endpoint or "")
    return view is not None and context.is_public(view)


def _add_headers(response: Response) -> Response:
    for name, value in _HEADERS.items():
        response.headers.setdefault(name, value)
    if request.is_secure:
        response.headers.setdefault("Strict-Transport-Security", f"max-age={_ONE_YEAR_S}")
    if g.get("framable", False):
        del response.headers["X-Frame-Options"]
    response.headers.setdefault("Content-Security-Policy", _policy())
    if request.endpoint != "static":
        response.headers.setdefault("Cache-Control", "private, no-cache")
    return response


def _policy() -> str:
    frames = "*" if g.get("framable", False) else "'none'"
    scripts = " ".join(("'self'", *g.get("inline_scripts", ())))
    images = " ".join(("'self'", "data:", "blob:", *g.get("image_origins", ())))
    rules = (
        "default-src 'self'",
        f"script-src {scripts}",
        f"img-src {images}",
        "media-src 'self' blob:",
        "worker-src 'self'",
        "object-src 'none'",
        f"frame-ancestors {frames}",
        "base-uri 'none'",
        "form-action 'self'",
    )
    return "; ".join(rules)
