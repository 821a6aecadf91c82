"""How long a zip says its list of files is: `zipfile` reads all of it, some 700 bytes of memory a file."""

from __future__ import annotations

from pathlib import Path

_END, _END_BYTES = b"PK\x05\x06", 22
_END64, _END64_BYTES, _LOCATOR, _LOCATOR_BYTES = b"PK\x06\x06", 56, b"PK\x06\x07", 20
_MAX_COMMENT = 65_535

_BYTES_PER_FILE = 250
"""Of the list, for a usual file; at least 46, and its name."""


def has_many_files(path: Path, *, limit: int) -> bool:
    """Return whether the list of a zip's files is longer than so many files with usual names need.

    Where it is, there are more files than that, or their names and notes are very long. What is no zip has
    none.
    """
    return _directory_bytes(path) > limit * _BYTES_PER_FILE + _MAX_COMMENT


def _directory_bytes(path: Path) -> int:
    """Find what `zipfile` will take for the length of the list: the record at the end of the file."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _END_BYTES - _MAX_COMMENT - _LOCATOR_BYTES - _END64_BYTES))
        tail = file.read()
    at = len(tail) - _END_BYTES
    if not (tail[at : at + 4] == _END and tail.endswith(b"\0\0")):
        at = tail.rfind(_END)
    if at < 0:
        return 0
    wide = at - _LOCATOR_BYTES - _END64_BYTES
    if wide >= 0 and tail.startswith(_LOCATOR, at - _LOCATOR_BYTES) and tail.startswith(_END64, wide):
        return int.from_bytes(tail[wide + 40 : wide + 48], "little")
    return int.from_bytes(tail[at + 12 : at + 16], "little")
