"""XML of tracks and maps: a streaming reader for untrusted files, and escaping for streaming writers.

The reader refuses document types, entities, deep nesting and names that would need far more memory than the
file has bytes: Expat writes the whole address of a namespace into every name that has its prefix, and keeps
all of them. Elements are released once they are read.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Collection, Iterator
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError
from xml.sax.saxutils import escape, quoteattr

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

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


MAX_DEPTH = 60
_NO_MEMORY = 1
"""Expat's code of this error."""

MOST_INSIDE = 1_000_000
"""Elements inside one that is yielded with its children, some 150 bytes of memory each."""

DECLARATION = '<?xml version="1.0" encoding="UTF-8"?>\n'

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def local_name(element: Element) -> str:
    """Return an element's name without its namespace; empty for a comment or a processing instruction."""
    return element.tag.rsplit("}", 1)[-1] if isinstance(element.tag, str) else ""


def walk(file: BinaryIO, *, whole: Collection[str]) -> Iterator[tuple[str, Element]]:
    """Parse a document element by element.

    Args:
        whole: Names, without namespaces, of elements that are yielded only at their end, with their children.
            All others are yielded empty at their start, and with their own text but without children at their
            end.

    Yields:
        event: {"start", "end"}. There are no events for the children of an element in `whole`.
        element: Valid until the next event.

    Raises:
        TrackError: The XML is malformed, nested too deeply, has too many or too long names, or declares a
            document type or entities.
    """
    stack: list[Element] = []
    inside = kept = 0
    for event, element in _events(file):
        if event == "start":
            stack.append(element)
            if len(stack) > MAX_DEPTH:
                raise TrackError(f"its elements are nested more than {MAX_DEPTH} deep")
            if inside or local_name(element) in whole:
                inside += 1
                kept += 1
                if kept > MOST_INSIDE:
                    raise TrackError(f"one of its elements has more than {MOST_INSIDE} others inside")
            else:
                yield "start", element
            continue
        stack.pop()
        inside = max(inside - 1, 0)
        if not inside:
            kept = 0
            yield "end", element
            if stack:
                stack[-1].remove(element)


def child_text(element: Element, name: str) -> str:
    """Return the stripped text of the first child with this local name; empty without one."""
    return next(((child.text or "").strip() for child in element if local_name(child) == name), "")


def number(text: str | None) -> float:
    """Parse a finite number; NaN for anything else."""
    try:
        value = float(text) if text else math.nan
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def element(tag: str, text: object, **attributes: str) -> str:
    """Write an element with text; characters that XML does not allow become question marks."""
    inner = "".join(f" {name}={quoted(value)}" for name, value in attributes.items())
    return f"<{tag}{inner}>{escape(_NOT_XML.sub('?', str(text)))}</{tag}>"


def quoted(text: str) -> str:
    """Write an attribute's value, with quotes."""
    return quoteattr(_NOT_XML.sub("?", text))


def _events(file: BinaryIO) -> Iterator[tuple[str, Element]]:
    guarded = Guarded(file)
    try:
        for event, element in iterparse(guarded, events=("start", "end"), forbid_dtd=True):
            if event == "start":
                guarded.enter(element)
            yield event, element
    except DefusedXmlException as error:
        hint = "such a file can exhaust the memory of its reader: export the track again"
        raise TrackError("the XML declares a document type or entities", hint=hint) from error
    except ParseError as error:
        if error.code == _NO_MEMORY:
            raise MemoryError from error
        raise _damaged(error) from error
    except (ValueError, LookupError, RecursionError) as error:
        # an unknown encoding raises LookupError, a multi-byte encoding ValueError
        raise _damaged(error) from error


def _damaged(error: Exception) -> TrackError:
    return TrackError(f"the XML is damaged: {str(error)[:200]}", hint="export the track again")
