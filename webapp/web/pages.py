"""Common template variables and filters of all pages, and helpers for pages with forms."""

from __future__ import annotations

from datetime import datetime
from decimal import Decimal
from typing import Any
from urllib.parse import urlsplit

from flask import Flask, redirect, request, url_for
from flask_babel import format_datetime, format_decimal, format_timedelta
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.core.texts import significant
from webapp.extras import is_installed
from webapp.store.clock import now
from webapp.web import language, manual
from webapp.web.accounts import sessions

_THEMES = ("light", "dark")


def init_app(app: Flask) -> None:
    """Pass the account, the language and the filters of times, numbers and messages to all templates."""
    app.context_processor(_common)
    app.add_template_filter(_sentence, "sentence")
    app.add_template_filter(language.translate, "translate")
    app.add_template_filter(_ago, "ago")
    app.add_template_filter(_exact, "exact")
    app.add_template_filter(format_decimal, "decimal")
    app.add_template_filter(_significant, "significant")


def _significant(value: float) -> str:
    """Format a number with three significant digits; Babel's own pattern for this, `@##`, cuts small ones."""
    return str(format_decimal(Decimal(significant(value)), "#,##0.############"))


def map_tabs() -> list[tuple[str, str, str]]:
    """List the pages of a map: last part of the path, icon, and name."""
    return [
        ("edit", "pin", _("Edit")),
        ("localize", "target", _("Localize")),
        ("image", "image", _("Image")),
        ("landmarks", "cube", _("3D")),
        ("quality", "check", _("Quality")),
        ("jobs", "clock", _("Jobs")),
        ("settings", "settings", _("Settings")),
    ]


def _common() -> dict[str, Any]:
    theme = request.cookies.get("expmap-theme")
    return {
        "account": sessions.signed_in(),
        "installed": is_installed,
        "language": language.current(),
        "languages": language.LANGUAGES,
        "help_address": manual.address,
        "map_tabs": map_tabs,
        "script_catalogue": language.script_catalogue,
        "theme": theme if theme in _THEMES else None,
    }


def _sentence(text: str) -> str:
    """Capitalise the first letter: messages begin with a small one, as is usual in a terminal."""
    return text[:1].upper() + text[1:]


def _ago(when: datetime) -> str:
    return str(format_timedelta(when - now(), granularity="second", add_direction=True))


def _exact(when: datetime) -> str:
    return str(format_datetime(when, "medium"))


def text(name: str) -> str:
    """Return a field of the form, or an empty text if it is missing."""
    return request.form.get(name, "")


def own_path(address: str | None) -> str | None:
    """Return path and query of a URL from a client, to prevent redirects to other sites.

    Returns:
        None if it is not a path of this site.
    """
    parts = urlsplit((address or "").replace("\\", "/"))
    if not parts.path.startswith("/") or parts.path.startswith("//"):
        return None
    return f"{parts.path}?{parts.query}" if parts.query else parts.path


def back(endpoint: str, **values: Any) -> Response:
    """Redirect to a page after a form was processed, so that a reload does not submit it again."""
    return redirect(url_for(endpoint, **values), code=303)
