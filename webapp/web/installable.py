"""What makes the pages an application that can be installed and that opens without a network."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from flask import Blueprint, Flask, Response, current_app, jsonify, render_template, url_for
from flask_babel import gettext as _

from webapp.web import language
from webapp.web.context import public
from webapp.web.localize.answers import answer_colours

VERSION_HEADER = "Expmap-Shell"
"""On each page: by it the service worker knows whether the files that it keeps are those of the page."""

_SUFFIXES = frozenset({".css", ".js", ".png", ".svg"})
_LEFT_OUT = frozenset({"js/sw.js"})

_Facts = tuple[tuple[str, int, int], ...]

blueprint = Blueprint("installable", __name__)
_GREEN = "#0b665c"
_GROUND = "#f5f6f4"
_ICONS = (
    ("icon-192.png", 192, "any"),
    ("icon-512.png", 512, "any"),
    ("icon-maskable-512.png", 512, "maskable"),
)


@blueprint.get("/field")
def field() -> str:
    """Show the page that keeps photos until there is a network; it holds nothing of any map itself."""
    return render_template("localize/field.html", colours=answer_colours())


@blueprint.get("/offline")
def offline() -> str:
    """Show the page that stands in for pages that a device has not kept, while there is no network."""
    return render_template("operate/offline.html")


@blueprint.get("/manifest.webmanifest")
@public
def manifest() -> Response:
    """Describe the application to the browser that installs it."""
    icons: list[dict[str, Any]] = [
        {"src": _image(name), "sizes": f"{side}x{side}", "type": "image/png", "purpose": purpose}
        for name, side, purpose in _ICONS
    ]
    response = jsonify(
        id="/",
        name="Experience Map",
        short_name="Experience Map",
        description=_("Where was this photo taken?"),
        lang=language.current(),
        start_url="/",
        scope="/",
        display="standalone",
        theme_color=_GREEN,
        background_color=_GROUND,
        icons=icons,
        shortcuts=[{"name": _("In the field"), "url": url_for("installable.field")}],
    )
    response.mimetype = "application/manifest+json"
    return response


@blueprint.get("/sw.js")
@public
def service_worker() -> Response:
    """Send the service worker from where it may look after all pages, with the files that it keeps."""
    kept = json.dumps({"version": version(), "files": addresses()})
    with current_app.open_resource(f"{current_app.static_folder}/js/sw.js", "r", encoding="utf-8") as file:
        script = f"const SHELL = {kept};\n{file.read()}"
    return Response(script, mimetype="text/javascript")


def _image(name: str) -> str:
    return url_for("static", filename=f"img/{name}")


def init_app(app: Flask) -> None:
    """Send the version of the files with every page."""
    app.after_request(_add_version)


def version() -> str:
    """Return the version of the files: another content has another one."""
    folder = _folder()
    return _hashed(folder, _facts(folder))


def addresses() -> list[str]:
    """List the addresses of the files."""
    return [url_for("static", filename=name) for name, _size, _time in _facts(_folder())]


def _folder() -> Path:
    folder = current_app.static_folder
    assert folder is not None, "create_app always gives one"
    return Path(folder)


def _facts(folder: Path) -> _Facts:
    """Return name, size and time of each file: whether the content has to be read again."""
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix in _SUFFIXES and name not in _LEFT_OUT:
            stat = path.stat()
            found.append((name, stat.st_size, stat.st_mtime_ns))
    return tuple(found)


@lru_cache(maxsize=4)
def _hashed(folder: Path, facts: _Facts) -> str:
    total = hashlib.sha256()
    for name, _size, _time in facts:
        total.update(name.encode() + b"\0" + hashlib.sha256((folder / name).read_bytes()).digest())
    return total.hexdigest()[:16]


def _add_version(response: Response) -> Response:
    if response.mimetype == "text/html":
        response.headers[VERSION_HEADER] = version()
    return response
