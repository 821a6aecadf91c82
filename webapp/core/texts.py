"""What people write: which characters it may have, and how names are kept."""

from __future__ import annotations

from unicodedata import category, normalize

_CONTROLS = ("Cc", "Cs", "Zl", "Zp")
"""Categories of Unicode: control characters, surrogates, and separators of lines and of paragraphs."""

_UNSEEN = (*_CONTROLS, "Cf", "Zs")
"""With formats and spaces; a character that is newer than this Python's Unicode may be a letter."""

_NO_CHARACTERS = "\ufffe\uffff"
"""What XML cannot hold, besides."""

_DIRECTIONS = dict.fromkeys(map(ord, "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"))
"""Marks that turn around what follows a name, on a page or in a terminal."""


def has_controls(text: str, *, besides: str = "") -> bool:
    """Return whether a text has control characters; `isprintable` would refuse no-break spaces, too.

    Parameters
    ----------
    besides : str
        Control characters that are allowed: line breaks, say.
    """
    return any(c not in besides and (category(c) in _CONTROLS or c in _NO_CHARACTERS) for c in text)


def is_line(text: str, *, most: int) -> bool:
    """Return whether a text is one line of 1 to `most` characters that can be read.

    It has no spaces at its ends, something that can be seen, and nothing that turns around what follows it.
    """
    is_read = any(category(c) not in _UNSEEN for c in text) and text == text.translate(_DIRECTIONS)
    return len(text) <= most and is_read and text == text.strip() and not has_controls(text)


def tidy_name(name: str, *, most: int) -> str | None:
    """Return a name as it is kept; None where it is none of 1 to `most` characters.

    Accents are composed, and spaces of any kind, no-break ones too, are one plain space: what looks the same
    is the same, and can be typed in a search.
    """
    tidy = " ".join(normalize("NFC", name).translate(_DIRECTIONS).split())
    return tidy if is_line(tidy, most=most) else None


def visible(name: str) -> str:
    """Return what can be seen of a name: two of which this is the same look alike."""
    return " ".join("".join(c for c in normalize("NFKC", name) if category(c) != "Cf").split())


def plain(name: str) -> str:
    """Return a name without what does not matter in it: capital letters, spaces, what cannot be seen."""
    return visible(name).casefold()


def folded(text: str) -> str:
    """Return a text as it is searched: as `plain` does, and without accents."""
    if text.isascii():
        return " ".join(text.split()).casefold()
    return "".join(c for c in normalize("NFKD", plain(text)) if category(c) != "Mn")
