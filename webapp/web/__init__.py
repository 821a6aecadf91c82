"""The web application: pages for people and an API for programs, for one library."""

from __future__ import annotations

from datetime import timedelta
from functools import partial

from apiflask import APIFlask
from flask import request
from werkzeug.middleware.proxy_fix import ProxyFix
from werkzeug.routing import IntegerConverter, Map

from webapp import __version__
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.errors import UsageError
from webapp.resources import resource_folder
from webapp.settings import Settings
from webapp.store.accounts.secret_key import secret_key
from webapp.store.library import Library, open_library
from webapp.tasks.operate.open_storage import open_storage
from webapp.web import (
    compression,
    concurrency,
    errors,
    json_bodies,
    language,
    openapi,
    pages,
    request_log,
    static_files,
)
from webapp.web.accounts import security, sessions, ways
from webapp.web.operate import metrics
from webapp.web.state import KEY, AppState, Parts

_PARTS = (
    request_log,
    metrics,
    compression,
    concurrency,
    security,
    sessions,
    ways,
    language,
    static_files,
    pages,
    errors,
    json_bodies,
    openapi,
)
"""Their hooks run in this order before a request, and in reverse order after it."""


class IdConverter(IntegerConverter):
    """URL converter, as in `<id:map_id>`: an integer in the range of database ids."""

    def __init__(self, url_map: Map) -> None:
        super().__init__(url_map, max=MAX_NUMBER)


def make_app(settings: Settings, parts: Parts, *, library: Library | None = None) -> APIFlask:
    """Make the application from its parts (listed in `webapp.app.web`)."""
    library = library or open_library(settings.library, url=settings.database, threads=settings.serve.threads)
    open_storage(library, settings)
    app = openapi.Application(
        __name__,
        title="Experience Map",
        version=__version__,
        spec_path=openapi.PATH,
        docs_path=None,
        json_errors=False,
        static_folder=None,  # type: ignore[arg-type]  # `static_files` registers the route
        template_folder=str(resource_folder("templates")),
    )
    app.static_folder = str(resource_folder("static"))
    app.extensions[KEY] = AppState(library, settings, parts)
    app.config.update(
        SECRET_KEY=secret_key(library.inner),
        MAX_CONTENT_LENGTH=int(settings.web.max_request_mb * 1e6),
        PERMANENT_SESSION_LIFETIME=timedelta(days=settings.web.session_days),
    )
    app.jinja_options = {"trim_blocks": True, "lstrip_blocks": True}
    app.url_map.converters["id"] = IdConverter
    for part in _PARTS:
        part.init_app(app)
    app.before_request(_refuse_prefix)
    for blueprint in parts.blueprints:
        app.register_blueprint(blueprint)
    if settings.web.proxies:
        trusted = partial(ProxyFix, x_for=settings.web.proxies, x_proto=settings.web.proxies)
        app.wsgi_app = trusted(app.wsgi_app, x_host=settings.web.proxies)  # type: ignore[method-assign]
    return app


def _refuse_prefix() -> None:
    """Refuse what a proxy took from below a path: links, cookies and the service worker are of a host."""
    prefix = request.headers.get("X-Forwarded-Prefix", request.script_root).strip().strip("/")
    if prefix:
        raise UsageError(
            f"Experience Map cannot be served below a path (/{prefix[:80]})",
            hint="give it a host name or a port of its own: maps.example.org, not example.org/maps",
        )
