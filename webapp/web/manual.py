"""The manual: the documentation as pages, and the mapping of pages to chapters."""

from __future__ import annotations

from flask import Blueprint, redirect, render_template, request, send_from_directory
from markupsafe import Markup
from werkzeug.wrappers import Response

from webapp.render import manual

blueprint = Blueprint("manual_pages", __name__, url_prefix="/help")

_FIRST = "make-a-map#1-a-new-map-and-its-image"
"""The chapter after the installation: readers of the manual are already signed in."""
_OF_PAGES = {
    "map_pages.editor": "make-a-map#3-place",
    "map_pages.settings": "sharing",
    "satellite_pages": "satellite",
    "localize_pages.localize": "localization#in-the-browser",
    "localize_pages.quality": "measurements#how-to-read-an-evaluation",
    "landmarks_pages.show": "dozen-clicks#landmarks-in-3d",
    "landmarks_pages.control_points": "dozen-clicks#control-points",
    "jobs_pages": "operating#what-to-watch",
    "mission_pages": "missions",
    "installable": "field",
    "account_pages": "operating#accounts",
    "people_pages": "operating#accounts",
    "model_pages": "operating#models",
}
"""Chapter of a view, or of all views of a blueprint."""


@blueprint.get("")
def index() -> Response:
    """Redirect to the first chapter."""
    return redirect(f"/help/{_FIRST}")


@blueprint.get("/<name>")
def show(name: str) -> str:
    """Show a chapter."""
    found = manual.chapter(name)
    return render_template(
        "operate/manual.html", chapter=found, html=Markup(found.html), parts=manual.titles()
    )


@blueprint.get(f"/{manual.PICTURES}/<name>")
def picture(name: str) -> Response:
    """Send a picture of the documentation."""
    return send_from_directory(manual.folder() / manual.PICTURES, name)


def address() -> str:
    """Return the URL of the chapter that explains the current page."""
    chapter = _OF_PAGES.get(request.endpoint or "") or _OF_PAGES.get(request.blueprint or "") or _FIRST
    return f"/help/{chapter}"
