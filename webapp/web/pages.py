"""What every page needs besides its own content."""

from __future__ import annotations

from typing import Any

from flask import Flask

from webapp.web import language, sessions


def init_app(app: Flask) -> None:
    """Give all templates the account, the language and the scripts' translations."""
    app.context_processor(_common)


def _common() -> dict[str, Any]:
    return {
        "account": sessions.signed_in(),
        "language": language.current(),
        "languages": language.LANGUAGES,
        "script_catalogue": language.script_catalogue,
    }
