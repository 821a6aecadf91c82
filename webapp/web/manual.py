"""The manual: the documentation as pages."""

from __future__ import annotations

from flask import Blueprint, redirect, render_template, send_from_directory
from markupsafe import Markup
from werkzeug.wrappers import Response

from webapp.render import manual
from webapp.web.pages import FIRST_CHAPTER, page

blueprint = Blueprint("manual_pages", __name__, url_prefix="/help")


@blueprint.get("")
def index() -> Response:
    """Redirect to the first chapter."""
    return redirect(f"/help/{FIRST_CHAPTER}")


@blueprint.get("/<name>")
@page()
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
