"""What every page needs besides its own content."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from flask import Flask, request
from flask_babel import format_datetime, format_timedelta
from flask_babel import gettext as _

from webapp.extras import is_installed
from webapp.store.clock import now
from webapp.web import language
from webapp.web.accounts import sessions

_THEMES = ("light", "dark")


def init_app(app: Flask) -> None:
    """Give all templates the account, the language and the words around times and messages."""
    app.context_processor(_common)
    app.add_template_filter(_sentence, "sentence")
    app.add_template_filter(language.told, "told")
    app.add_template_filter(_ago, "ago")
    app.add_template_filter(_exact, "exact")


def map_tabs() -> list[tuple[str, str, str]]:
    """List the pages of a map: last part of the address, icon, and name."""
    return [
        ("edit", "pin", _("Edit")),
        ("localize", "target", _("Localize")),
        ("image", "image", _("Image")),
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
        "map_tabs": map_tabs,
        "script_catalogue": language.script_catalogue,
        "theme": theme if theme in _THEMES else None,
    }


def _sentence(text: str) -> str:
    """Begin with a capital letter: messages are written without one, as for a terminal."""
    return text[:1].upper() + text[1:]


def _ago(when: datetime) -> str:
    return str(format_timedelta(when - now(), granularity="second", add_direction=True))


def _exact(when: datetime) -> str:
    return str(format_datetime(when, "medium"))
