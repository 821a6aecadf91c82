"""Refuses XML whose names would need far more memory than its file has bytes, before it is parsed.

Expat writes the whole address of a namespace into every name that has its prefix, and keeps all of them.
"""

from __future__ import annotations

import codecs
import re
from typing import BinaryIO
from xml.etree.ElementTree import Element

from webapp.errors import TrackError

_MOST_NAMES = 10_000
"""Of elements and attributes that differ, in a file; and attributes of an element."""

_LONGEST = 300
"""Bytes of a namespace; those in use have at most about a hundred."""

_LONG_NAMESPACE = re.compile(
    rb"""xmlns(?:N{300}|N{0,300}(?:\s{300}|\s{0,300}=(?:\s{300}|\s{0,300}(?:"[^"]{300}|'[^']{300}))))""".replace(
        b"N", rb"""[^\s=<>"'/&]"""
    ).replace(b"300", str(_LONGEST).encode())
)
"""Also a declaration that is too long in another way, so that no match has more than `_OVERLAP` bytes."""

_OVERLAP = 5 * _LONGEST
_ATTRIBUTE = re.compile(rb"=\s*[\"']")
_HINT = "such a file can exhaust the memory of its reader: export the track again"


class Guarded:
    """The bytes of a document for a parser; reading hostile ones raises TrackError."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._decoder: codecs.IncrementalDecoder | None = None
        self._begun = False
        self._tail = b""
        self._names: set[str] = set()
        self._attributes = 0

    def read(self, size: int) -> bytes:
        """Read the next bytes."""
        data = self._file.read(size)
        self._check(data)
        return data

    def enter(self, element: Element) -> None:
        """Note the names of an element that the parser has begun."""
        self._names.add(element.tag)
        self._names.update(element.attrib)
        if len(self._names) > _MOST_NAMES:
            raise TrackError(f"the XML has more than {_MOST_NAMES} different names", hint=_HINT)

    def _check(self, data: bytes) -> None:
        new = self._as_ascii(data)
        text = self._tail + new
        if _LONG_NAMESPACE.search(text):
            raise TrackError(f"the XML has a namespace of more than {_LONGEST} characters", hint=_HINT)
        tag = new.rfind(b"<")
        known = 0 if tag >= 0 else self._attributes
        self._attributes = known + len(_ATTRIBUTE.findall(new, max(tag, 0)))
        if self._attributes > _MOST_NAMES:
            raise TrackError(f"an element of the XML has more than {_MOST_NAMES} attributes", hint=_HINT)
        self._tail = text[-_OVERLAP:]

    def _as_ascii(self, data: bytes) -> bytes:
        """Return a text of UTF-16 as UTF-8; all other encodings that Expat knows have ASCII for markup."""
        if not self._begun:
            self._begun = True
            if data[:2] == b"\xff\xfe" or data[1:2] == b"\0":
                self._decoder = codecs.getincrementaldecoder("utf-16-le")("replace")
            elif data[:2] == b"\xfe\xff" or data[:1] == b"\0":
                self._decoder = codecs.getincrementaldecoder("utf-16-be")("replace")
        return data if self._decoder is None else self._decoder.decode(data).encode("utf-8", "replace")
