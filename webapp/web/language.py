"""The language of the pages: that of the account, else the one preferred by the browser."""

from __future__ import annotations

import gettext as gnu_gettext
from typing import Any

from babel import Locale
from flask import Flask, request, session
from flask_babel import Babel, get_locale, gettext, lazy_gettext

from webapp.errors import NotSignedIn
from webapp.render.language import LANGUAGES as CODES
from webapp.render.language import TRANSLATIONS
from webapp.web.accounts import sessions

_COUNTED = 200
"""Numbers below this use all plural forms of European languages."""


def _own_name(code: str) -> str:
    name = Locale.parse(code).get_language_name(code) or code
    return name[:1].upper() + name[1:]


LANGUAGES = {code: _own_name(code) for code in CODES}
"""Codes of English and of all translations, with the languages' own names."""


def init_app(app: Flask) -> None:
    Babel(app, locale_selector=_choose, default_translation_directories=str(TRANSLATIONS))


def current() -> str:
    """Return the language of this request, one of `LANGUAGES`."""
    return str(get_locale())


def translate(message: str) -> str:
    """Translate an error message if the catalogue has it; messages with numbers or names stay English."""
    return str(gettext(message)) if message else message


_PLAIN_NOTES = {
    "calibrating on real queries": lazy_gettext("checking how sure the answers may be, on real photos"),
    "calibrating the probabilities": lazy_gettext("checking how sure the answers may be"),
    "computing global descriptors": lazy_gettext("comparing the photos as a whole"),
    "joining": lazy_gettext("putting the index together"),
    "leave-one-out": lazy_gettext("looking for each photo as if it were not on the map"),
    "leave-one-place-out": lazy_gettext("the same without the photos around it"),
    "fusing odometry and fixes": lazy_gettext("combining odometry and GPS"),
    "training": lazy_gettext("learning what the photos look like"),
    "training the descriptor of photos": lazy_gettext("learning what the photos of all maps look like"),
}
"""Notes of jobs in plain words; the command line shows them in those of the field."""

_PLAIN_BEGINNINGS = {
    "second look: ": lazy_gettext("the same for a second look at difficult photos"),
    "without a second look: ": lazy_gettext("without a second look at difficult photos"),
}
"""The same for notes that go on with a name or a reason."""


def _plain_note(note: str) -> str:
    for beginning, words in _PLAIN_BEGINNINGS.items():
        if note.startswith(beginning):
            return str(words)
    return str(_PLAIN_NOTES[note]) if note in _PLAIN_NOTES else translate(note)


def translate_job(job: dict[str, Any]) -> dict[str, Any]:
    error = job["error"]
    if error:
        error = error | {part: translate(error[part]) for part in ("message", "hint") if error.get(part)}
    return job | {"note": _plain_note(job["note"]), "error": error}


def script_catalogue() -> dict[str, Any]:
    """Return the translations that the scripts need, for the current language.

    Returns:
        `language`, `plurals` (the category of each plural form, as named by `Intl.PluralRules`), and
            `messages`: text to translation, or to a list of translations by plural form.
    """
    language = current()
    messages: dict[str, Any] = {}
    plurals: list[str] = []
    if gnu_gettext.find("scripts", TRANSLATIONS, [language]):
        catalogue = gnu_gettext.translation("scripts", TRANSLATIONS, [language])
        plurals = _plurals(language, catalogue)
        for key, text in catalogue._catalog.items():  # type: ignore[attr-defined]
            if isinstance(key, tuple):
                messages.setdefault(key[0], {})[key[1]] = text
            elif key:
                messages[key] = text
    forms = {k: [v[i] for i in sorted(v)] if isinstance(v, dict) else v for k, v in messages.items()}
    return {"language": language, "plurals": plurals, "messages": forms}


def _plurals(language: str, catalogue: gnu_gettext.NullTranslations) -> list[str]:
    category = Locale.parse(language).plural_form
    names: dict[int, str] = {}
    for n in range(_COUNTED):
        names.setdefault(catalogue.plural(n), category(n))  # type: ignore[attr-defined]
    return [names[form] for form in sorted(names)]


def _choose() -> str | None:
    try:
        account = sessions.signed_in()
    except NotSignedIn:
        account = None  # the error response needs a language as well
    chosen = session.get("language") if account is None else account.language
    if chosen in LANGUAGES:
        return chosen
    # Not `best_match`: for "en-US, cs;q=0.5" it returns Czech, the only exact match.
    preferred = [code.partition("-")[0].lower() for code, quality in request.accept_languages if quality > 0]
    return next((code for code in preferred if code in LANGUAGES), None)
