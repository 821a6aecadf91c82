"""The language of the pages: that of the account, else what the browser prefers."""

from __future__ import annotations

import gettext as gnu_gettext
from pathlib import Path
from typing import Any

from flask import Flask, request, session
from flask_babel import Babel, get_locale, gettext

from webapp.errors import NotSignedIn
from webapp.web.accounts import sessions

LANGUAGES = {"en": "English", "cs": "Čeština"}
"""Each by its own name."""

TRANSLATIONS = Path(__file__).parent / "translations"

_PLURALS = {"en": ["one", "other"], "cs": ["one", "few", "other"]}
"""Which plural each form of the catalogue is for, in the words of `Intl.PluralRules`."""


def init_app(app: Flask) -> None:
    """Connect Flask-Babel."""
    Babel(app, locale_selector=_choose, default_translation_directories=str(TRANSLATIONS))


def current() -> str:
    """Return the language of this request: `en` or `cs`."""
    return str(get_locale())


def translate(message: str) -> str:
    """Translate what an error says, where the catalogue has it; numbers and names in it keep it English."""
    return str(gettext(message)) if message else message


def script_catalogue() -> dict[str, Any]:
    """Return the translations that the scripts need, for the current language.

    Returns
    -------
    dict
        `language`, `plurals` (the names of the forms), and `messages`: text to translation, or to a list
        of them by plural form.
    """
    language = current()
    messages: dict[str, Any] = {}
    if gnu_gettext.find("scripts", TRANSLATIONS, [language]):
        catalogue = gnu_gettext.translation("scripts", TRANSLATIONS, [language])._catalog  # type: ignore[attr-defined]
        for key, text in catalogue.items():
            if isinstance(key, tuple):
                messages.setdefault(key[0], {})[key[1]] = text
            elif key:
                messages[key] = text
    forms = {k: [v[i] for i in sorted(v)] if isinstance(v, dict) else v for k, v in messages.items()}
    return {"language": language, "plurals": _PLURALS[language], "messages": forms}


def _choose() -> str | None:
    try:
        account = sessions.signed_in()
    except NotSignedIn:
        account = None  # which the answer is going to say; it needs a language for that
    chosen = session.get("language") if account is None else account.language
    return chosen if chosen in LANGUAGES else request.accept_languages.best_match(LANGUAGES)
