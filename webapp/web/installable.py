"""What makes the pages an application that can be installed and that opens without a network."""

from __future__ import annotations

import json
from typing import Any

from flask import Blueprint, Response, current_app, jsonify, render_template, url_for
from flask_babel import gettext as _

from webapp.web import language, shell
from webapp.web.accounts.access import public
from webapp.web.localize.answer_colours import answer_colours

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
    kept = json.dumps({"version": shell.version(), "files": shell.addresses()})
    with current_app.open_resource(f"{current_app.static_folder}/js/sw.js", "r", encoding="utf-8") as file:
        script = f"const SHELL = {kept};\n{file.read()}"
    return Response(script, mimetype="text/javascript")


def _image(name: str) -> str:
    return url_for("static", filename=f"img/{name}")
