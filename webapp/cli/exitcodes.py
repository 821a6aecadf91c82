"""Exit codes of the commands, and their mapping from errors."""

from __future__ import annotations

from webapp.errors import Cancelled, ExpMapError, MapError, MissingPart, UsageError

DONE = 0
SOME_FAILED = 1
USAGE = 2
BAD_MAP = 3
MISSING_PART = 4
INTERRUPTED = 130

_TABLE: tuple[tuple[type[ExpMapError], int], ...] = (
    (UsageError, USAGE),
    (MapError, BAD_MAP),
    (MissingPart, MISSING_PART),
    (Cancelled, INTERRUPTED),
)


def exit_code(error: ExpMapError) -> int:
    """Return the exit code for an error that ended a command; 1 for errors without one of their own."""
    return next((code for kind, code in _TABLE if isinstance(error, kind)), SOME_FAILED)
