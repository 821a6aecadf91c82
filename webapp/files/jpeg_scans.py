"""Counts the scans of a JPEG: each may pass over the whole photo again, in a few bytes of the file."""

from __future__ import annotations

import mmap
import re

MAX_SCANS = 32
"""Cameras write 1, usual programs 10 to 12."""

_START_OF_SCAN, _END_OF_IMAGE = b"\xda", b"\xd9"
_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])", re.DOTALL)
"""Within compressed data, 0xff is followed by 0x00 or by a restart marker."""


def has_too_many_scans(data: bytes | mmap.mmap) -> bool:
    """Return whether decoding a JPEG takes more than `MAX_SCANS` passes over it.

    Parameters
    ----------
    data : bytes or mmap
        The file; what follows the end of its first image plays no part.
    """
    scans, place = 0, 0
    while found := _MARKER.search(data, place):
        if found[1] == _END_OF_IMAGE:
            return False
        scans += found[1] == _START_OF_SCAN
        if scans > MAX_SCANS:
            return True
        end = found.end()
        is_start_of_image = found.start() == 0
        place = end if is_start_of_image else end + int.from_bytes(data[end : end + 2], "big")
    return False
