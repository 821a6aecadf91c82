"""Declared size of a zip's central directory, all read by `zipfile`: some 700 bytes of memory per file."""

from __future__ import annotations

from pathlib import Path

_END, _END_BYTES = b"PK\x05\x06", 22
_END64, _END64_BYTES, _LOCATOR, _LOCATOR_BYTES = b"PK\x06\x06", 56, b"PK\x06\x07", 20
_MAX_COMMENT = 65_535

_BYTES_PER_FILE = 250
"""In the central directory, for a usual file; at least 46 plus its name."""


def has_many_files(path: Path, *, limit: int) -> bool:
    """Return whether a zip's central directory is larger than `limit` files with usual names need.

    If so, there are more files, or their names and comments are very long. False if it is not a zip.
    """
    return _directory_bytes(path) > limit * _BYTES_PER_FILE + _MAX_COMMENT


def _directory_bytes(path: Path) -> int:
    """Read the size that `zipfile` will assume, from the record at the end of the file."""
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
