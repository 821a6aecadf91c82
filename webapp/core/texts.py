"""User-entered text: permitted characters, and normalisation of names. Numbers as text."""

from __future__ import annotations

from decimal import Context, Decimal
from unicodedata import category, normalize

_CONTROLS = ("Cc", "Cs", "Zl", "Zp")
"""Categories of Unicode: control characters, surrogates, and separators of lines and of paragraphs."""

_UNSEEN = (*_CONTROLS, "Cf", "Zs")
"""Also format characters and spaces. Characters newer than this Python's Unicode count as visible."""

_NO_CHARACTERS = "\ufffe\uffff"
"""Other characters that XML cannot contain."""

_LOOKALIKES = str.maketrans(
    "\u0430\u0432\u0435\u043a\u043c\u043d\u043e\u0440\u0441\u0442\u0443\u0445\u0456\u0458\u0455\u04bb\u0501\u051b\u051d"
    "\u03b1\u03b2\u03b5\u03b6\u03b7\u03b9\u03ba\u03bc\u03bd\u03bf\u03c1\u03c4\u03c5\u03c7\u0131",
    "abekmhopctyxijshdqwabezhikmnoptyxi",
)
"""Letters of other scripts and the Latin ones that they look like, after folding of case."""

_DIRECTIONS = dict.fromkeys(map(ord, "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"))
"""Bidirectional controls, which can reverse the text after a name on a page or in a terminal."""


def has_controls(text: str, *, besides: str = "") -> bool:
    """Return whether a text has control characters; `isprintable` would refuse no-break spaces, too.

    Args:
        besides: Control characters that are allowed, e.g. line breaks.
    """
    return any(c not in besides and (category(c) in _CONTROLS or c in _NO_CHARACTERS) for c in text)


def is_line(text: str, *, most: int) -> bool:
    """Return whether a text is one readable line of 1 to `most` characters.

    It has a visible character, and no spaces at its ends, control characters or bidirectional controls.
    """
    is_read = any(category(c) not in _UNSEEN for c in text) and text == text.translate(_DIRECTIONS)
    return len(text) <= most and is_read and text == text.strip() and not has_controls(text)


def tidy_name(name: str, *, most: int) -> str | None:
    """Return a name in its stored form; None if that is not a line of 1 to `most` characters.

    Accents are composed, and spaces of any kind, including no-break ones, become one plain space, so that
    names that look the same are equal and can be typed in a search.
    """
    tidy = " ".join(normalize("NFC", name).translate(_DIRECTIONS).split())
    return tidy if is_line(tidy, most=most) else None


def visible(name: str) -> str:
    """Return the visible part of a name: names that look alike have the same."""
    return " ".join("".join(c for c in normalize("NFKC", name) if category(c) != "Cf").split())


def plain(name: str) -> str:
    """Return a name for comparison, regardless of case, extra spaces and invisible characters."""
    return visible(name).casefold()


def looks(name: str) -> str:
    """Return a name for comparison by its looks: as from `plain`, with Latin letters for similar ones.

    These are letters of Cyrillic and Greek, in small or capital form.
    """
    return plain(name).translate(_LOOKALIKES)


def folded(text: str) -> str:
    """Return a text for searching: as from `plain`, and without accents."""
    if text.isascii():
        return " ".join(text.split()).casefold()
    return "".join(c for c in normalize("NFKD", plain(text)) if category(c) != "Mn")


def significant(value: float, digits: int = 3) -> str:
    """Return a number rounded to significant digits, without trailing zeros and never with an exponent."""
    rounded = Context(prec=digits).create_decimal_from_float(value)
    return f"{rounded.normalize() if rounded else Decimal(0):f}"
