"""XML from outside, element by element: no document types, no entities, not too deep, and nothing is kept."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from webapp.errors import TrackError

MAX_DEPTH = 60


def local_name(element: Element) -> str:
    """Give an element's name without its namespace; empty for what is no element."""
    return element.tag.rsplit("}", 1)[-1] if isinstance(element.tag, str) else ""


def walk(file: BinaryIO, *, whole: Collection[str]) -> Iterator[tuple[str, Element]]:
    """Go through a document.

    Parameters
    ----------
    file : binary file
    whole : collection of str
        Names, without namespaces, of the elements that are given complete with all that is in them; all
        others are given empty when they begin, and with their own text but without children when they end.

    Yields
    ------
    event : {"start", "end"}
        Elements inside of one of `whole` have no events of their own.
    element : Element
        To be looked at until the next one is asked for.

    Raises
    ------
    TrackError
        It is damaged, too deep, or declares a document type or entities.
    """
    stack: list[Element] = []
    inside = 0
    for event, element in _events(file):
        if event == "start":
            stack.append(element)
            if len(stack) > MAX_DEPTH:
                raise TrackError(f"its elements are nested more than {MAX_DEPTH} deep")
            if inside or local_name(element) in whole:
                inside += 1
            else:
                yield "start", element
            continue
        stack.pop()
        inside = max(inside - 1, 0)
        if not inside:
            yield "end", element
            if stack:
                stack[-1].remove(element)


def child_text(element: Element, name: str) -> str:
    """Give the text of the first child of a name, without blanks around it; empty without one."""
    return next(((child.text or "").strip() for child in element if local_name(child) == name), "")


def _events(file: BinaryIO) -> Iterator[tuple[str, Element]]:
    try:
        yield from iterparse(file, events=("start", "end"), forbid_dtd=True)
    except DefusedXmlException as error:
        hint = "such a file can blow up a reader's memory: export the track again"
        raise TrackError("the XML declares a document type or entities", hint=hint) from error
    except (ParseError, ValueError, LookupError, RecursionError) as error:
        # an unknown encoding is a LookupError, one of several bytes a character a ValueError
        raise TrackError(f"the XML is damaged: {str(error)[:200]}", hint="export the track again") from error
