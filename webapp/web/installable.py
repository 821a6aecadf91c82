"""Progressive web app: manifest, service worker, and the pages that work offline."""

from __future__ import annotations

import json
from typing import Any, cast

from flask import Blueprint, Response, current_app, jsonify, render_template, url_for
from flask_babel import gettext as _
from jinja2 import nodes

from webapp.web import language, static_files
from webapp.web.context import public
from webapp.web.localize.answers import answer_colours
from webapp.web.pages import page
from webapp.web.satellite.layers import offered_layers

_OFFLINE = (
    "maps/index.html",
    "maps/editor.html",
    "maps/view.html",
    "localize/localize.html",
    "localize/field.html",
    "missions/index.html",
    "operate/offline.html",
)
"""Templates of the pages that work offline: `KEPT_PAGES` of the service worker."""

blueprint = Blueprint("installable", __name__)
_GREEN = "#0b665c"
_GROUND = "#f5f6f4"
_ICONS = (
    ("icon-192.png", 192, "any"),
    ("icon-512.png", 512, "any"),
    ("icon-maskable-512.png", 512, "maskable"),
)


@blueprint.get("/field")
@page(chapter="field")
def field() -> str:
    """Show the page that stores photos until the device is online; it contains no data of any map."""
    return render_template("localize/field.html", colours=answer_colours(), services=offered_layers())


@blueprint.get("/offline")
@page(chapter="field")
def offline() -> str:
    """Show the offline page, which replaces pages that the device has not cached."""
    return render_template("operate/offline.html")


@blueprint.get("/manifest.webmanifest")
@public
def manifest() -> Response:
    """Send the web app manifest."""
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
    """Send the service worker, from a path whose scope is all pages, with the list of files to cache."""
    kept = json.dumps({"version": static_files.version(), "files": _kept_files()})
    with current_app.open_resource(f"{current_app.static_folder}/js/sw.js", "r", encoding="utf-8") as file:
        script = f"const SHELL = {kept};\n{file.read()}"
    return Response(script, mimetype="text/javascript")


def _image(name: str) -> str:
    return url_for("static", filename=f"img/{name}")


def _kept_files() -> list[str]:
    """List the URLs of all files that the offline pages need."""
    plain = [name for name in static_files.files() if name.startswith(("img/", "vendor/leaflet/"))]
    made = {address for template in _OFFLINE for address in _bundles(template)}
    return [*(url_for("static", filename=name) for name in plain), *sorted(made)]


def _bundles(template: str) -> tuple[str, str]:
    """Return the URLs of the bundles of scripts and of style sheets that a template uses."""
    env = current_app.jinja_env
    assert env.loader is not None, "Flask always gives one"
    names: dict[str, Any] = {"scripts": [], "sheets": [], "leaflet": False}
    for node in env.parse(env.loader.get_source(env, template)[0]).find_all(nodes.Assign):
        if isinstance(node.target, nodes.Name) and node.target.name in names:
            names[node.target.name] = cast(nodes.Expr, node.node).as_const()
    return (
        static_files.script_bundle(names["scripts"]),
        static_files.sheet_bundle(names["sheets"], leaflet=names["leaflet"]),
    )
