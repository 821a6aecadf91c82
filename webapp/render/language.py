"""Texts, numbers and times of a document in one of the languages of the pages."""

from __future__ import annotations

from datetime import datetime
from functools import lru_cache
from pathlib import Path
from zoneinfo import ZoneInfo

from babel import Locale
from babel.numbers import format_decimal
from babel.support import NullTranslations, Translations

import webapp
from webapp.errors import UsageError

TRANSLATIONS = Path(webapp.__file__).parent / "web" / "translations"

LANGUAGES = ("en", *sorted(path.parent.name for path in TRANSLATIONS.glob("*/LC_MESSAGES")))
"""Codes of English and of all translations."""

_NO_BREAK = "\u00a0"


class Language:
    """A language and a time zone.

    Raises:
        UsageError: One of them is unknown.
    """

    def __init__(self, code: str = "en", *, zone: str = "UTC") -> None:
        if code not in LANGUAGES:
            raise UsageError(
                f"there is no translation into {code!r}",
                where="language",
                hint=f"use {', '.join(LANGUAGES)}",
            )
        self.code = code
        self._locale = Locale.parse(code)
        self._texts = _catalogue(code)
        self._zone = _zone(zone)

    def text(self, message: str, **values: object) -> str:
        """Translate a text with `%(name)s` for values, as Flask-Babel does."""
        found = self._texts.ugettext(message)
        return found % values if values else found

    def plural(self, one: str, many: str, *, num: int, **values: object) -> str:
        """Translate a text that depends on a number, with `%(num)s` for it."""
        return self._texts.ungettext(one, many, num) % {"num": self.number(num), **values}

    def number(self, value: float, digits: int = 0) -> str:
        """Write a number with at most so many decimals."""
        form = "#,##0" + ("." + "#" * digits if digits else "")
        return str(format_decimal(value, format=form, locale=self._locale))

    def percent(self, share: float) -> str:
        """Write a share of one."""
        return f"{self.number(100 * share, 1)}{_NO_BREAK}%"

    def length(self, metres: float) -> str:
        if metres >= 1000:
            return f"{self.number(metres / 1000, 2 if metres < 10_000 else 1)}{_NO_BREAK}km"
        return f"{self.number(metres, 1 if metres < 100 else 0)}{_NO_BREAK}m"

    def area(self, square_metres: float) -> str:
        for unit, size in (("km²", 1e6), ("ha", 1e4)):
            if square_metres >= size:
                return f"{self.number(square_metres / size, 2)}{_NO_BREAK}{unit}"
        return f"{self.number(square_metres)}{_NO_BREAK}m²"

    def time(self, time_s: float) -> str:
        """Write a time of the zone, Unix seconds, to the second and in the order of ISO 8601."""
        return f"{self._at(time_s):%Y-%m-%d %H:%M:%S}"

    def span(self, first_s: float, last_s: float) -> str:
        """Write from when to when; the date once if it is the same."""
        first, last = self._at(first_s), self._at(last_s)
        form = "%H:%M:%S" if first.date() == last.date() else "%Y-%m-%d %H:%M:%S"
        return f"{first:%Y-%m-%d %H:%M:%S} – {last:{form}}"

    def duration(self, seconds: float) -> str:
        """Write hours, minutes and seconds."""
        minutes, rest = divmod(max(0, round(seconds)), 60)
        return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"

    @property
    def zone(self) -> str:
        """Name of the time zone."""
        return self._zone.key

    def offset(self, time_s: float) -> str:
        """Return the difference of the zone from UTC at a time: `UTC+02:00`."""
        return f"UTC{self._at(time_s).isoformat(timespec='seconds')[19:]}"

    def _at(self, time_s: float) -> datetime:
        return datetime.fromtimestamp(time_s, self._zone)


@lru_cache
def _catalogue(code: str) -> NullTranslations:
    return Translations.load(TRANSLATIONS, [code])


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (ValueError, OSError, LookupError) as error:
        raise UsageError(
            f"there is no time zone {name!r}", where="zone", hint="use a name such as Europe/Prague, or UTC"
        ) from error
