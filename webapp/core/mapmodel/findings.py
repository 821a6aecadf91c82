"""Problems of a map, as values: a linter lists them, a strict reader raises the first one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal


class Code(StrEnum):
    """The name of each kind of finding; `maps/FORMAT.md` explains all of them."""

    EMPTY_FILE = "empty-file"
    NOT_UTF8 = "not-utf-8"
    CONTROL_CHARACTER = "control-character"
    BLANK_LINE = "blank-line"
    WRONG_SEPARATOR = "wrong-separator"
    WRONG_COLUMN_COUNT = "wrong-column-count"
    NON_NUMERIC_ID = "non-numeric-id"
    DUPLICATE_ID = "duplicate-id"
    DECIMAL_COMMA = "decimal-comma"
    NOT_AN_INTEGER = "not-an-integer"
    NUMBER_OUT_OF_RANGE = "number-out-of-range"
    EMPTY_NAME = "empty-name"
    UNWRITABLE_NAME = "unwritable-name"
    BACKSLASH_IN_PATH = "backslash-in-path"
    PATH_LEAVES_FOLDER = "path-leaves-folder"
    POSITION_OUTSIDE_IMAGE = "position-outside-image"
    SWAPPED_XY = "swapped-xy"
    NO_PHOTOS = "no-photos"
    DUPLICATE_PHOTO = "duplicate-photo"
    MISSING_SATELLITE = "missing-satellite"
    UNREADABLE_SATELLITE = "unreadable-satellite"
    IMAGE_SIZE_DIFFERS = "image-size-differs"
    MISSING_PHOTO = "missing-photo"
    UNREADABLE_PHOTO = "unreadable-photo"
    NAME_SPELLING = "name-spelling"
    ORPHAN_PHOTO = "orphan-photo"
    MAP_JSON_DAMAGED = "map-json-damaged"
    MAP_JSON_POSITION = "map-json-position"
    MAP_JSON_STALE = "map-json-stale"
    NEXT_ID_TOO_SMALL = "next-id-too-small"
    MISSING_FLOOR = "missing-floor-image"
    PLACEMENT_DAMAGED = "placement-damaged"
    PLACEMENT_STALE = "placement-stale"


WARNINGS = frozenset(
    {
        Code.SWAPPED_XY,
        Code.NO_PHOTOS,
        Code.DUPLICATE_PHOTO,
        Code.NAME_SPELLING,
        Code.ORPHAN_PHOTO,
        Code.MAP_JSON_POSITION,
        Code.MAP_JSON_STALE,
        Code.NEXT_ID_TOO_SMALL,
        Code.PLACEMENT_STALE,
    }
)
"""Kinds of findings with which the map is still usable; all others are errors."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem, its place, and how to fix it."""

    code: Code
    # `line`, `column`: Both from 1; the column counts characters.
    line: int
    column: int
    message: str  # The problem, in one sentence
    fix: str  # What to do, with the corrected line if there is one
    file: str = ""  # Relative to the map's folder; empty for the `.cfg` itself

    @property
    def severity(self) -> Literal["error", "warning"]:
        """Whether the map is unusable ("error") or merely suspicious ("warning")."""
        return "warning" if self.code in WARNINGS else "error"


def quoted(text: str) -> str:
    """Quote text from a file for a message: one line, printable, not too long."""
    shown = repr(text if len(text) <= 60 else text[:57] + "...")
    return shown.encode("utf-8", "backslashreplace").decode("utf-8")
