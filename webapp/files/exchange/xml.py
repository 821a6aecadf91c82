"""XML of tracks and maps: a streaming reader for untrusted files, and escaping for streaming writers.

The reader refuses document types, entities, deep nesting and names that take much memory (`xml_guard.py`),
and releases elements once they are read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError
from xml.sax.saxutils import escape, quoteattr

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from webapp.errors import TrackError
from webapp.files.exchange.xml_guard import Guarded

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
