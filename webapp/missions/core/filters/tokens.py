"""Splits a condition into tokens."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, cast

from webapp.errors import UsageError

MAX_CHARACTERS = 2000

TokenKind = Literal["name", "number", "text", "sign", "end"]

_TOKEN = re.compile(
    r"""
    (?P<space>\s+)
    | (?P<name>[A-Za-z_][A-Za-z_0-9]*)
    | (?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | '(?P<text>(?:[^']|'')*)'
    | (?P<sign><=|>=|<>|!=|==|[=<>(),*])
    """,
    re.VERBOSE | re.ASCII,
)
_UNFIT = re.compile("[\x00\ud800-\udfff]")
"""Characters that databases cannot store as text."""


@dataclass(frozen=True, slots=True)
class Token:
    """A token."""

    kind: TokenKind
    text: str  # As written; for quoted text, without the quotes
    at: int  # Position of its first character, from 1

    def is_word(self, *words: str) -> bool:
        """Return whether it is one of these keywords, given in upper case."""
        return self.kind == "name" and self.text.upper() in words

    def is_sign(self, *signs: str) -> bool:
        """Return whether it is one of these operators or punctuation marks."""
        return self.kind == "sign" and self.text in signs

    def quoted(self) -> str:
        """Quote it for a message."""
        if self.kind == "end":
            return "the end"
        return f"'{self.text[:40]}'" if self.kind == "text" else f'"{self.text[:40]}"'


def tokens(text: str, field: str) -> list[Token]:
    """Split a text into tokens.

    Args:
        text: At most `MAX_CHARACTERS` long.
        field: Name of the text in messages: `where`.

    Returns:
        The last one has the kind "end".

    Raises:
        UsageError: The text is too long or has an invalid character; `where` names its position.
    """
    if len(text) > MAX_CHARACTERS:
        raise mistake(f"more than {MAX_CHARACTERS} characters", field=field, at=MAX_CHARACTERS + 1)
    unfit = _UNFIT.search(text)
    if unfit:
        raise mistake("an invalid character", field=field, at=unfit.start() + 1)
    found: list[Token] = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _strange(text, at, field=field)
        kind = cast("TokenKind | Literal['space']", match.lastgroup)
        if kind != "space":
            word = match[kind]
            found.append(Token(kind, word.replace("''", "'") if kind == "text" else word, at + 1))
        at = match.end()
    return [*found, Token("end", "", len(text) + 1)]


def mistake(message: str, *, field: str, at: int, hint: str | None = None) -> UsageError:
    """Return an error at the character `at`, counted from 1."""
    return UsageError(message, where=f"{field}, character {at}", hint=hint)


def _strange(text: str, at: int, *, field: str) -> UsageError:
    if text[at] == "'":
        return mistake("unterminated text", field=field, at=at + 1, hint="close it with another '")
    hint = "put text in single quotes: 'car'" if text[at] in '"`‘’“”' else None
    return mistake(f'unexpected character "{text[at]}"', field=field, at=at + 1, hint=hint)
