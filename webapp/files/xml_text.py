"""Pieces of XML that is written as it is sent, and times as its formats have them."""

from __future__ import annotations

import re
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import ArrayLike

DECLARATION = '<?xml version="1.0" encoding="UTF-8"?>\n'

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def element(tag: str, text: object, **attributes: str) -> str:
    """Write an element that holds a text alone; characters that XML cannot hold become question marks."""
    inner = "".join(f" {name}={quoted(value)}" for name, value in attributes.items())
    return f"<{tag}{inner}>{escape(_NOT_XML.sub('?', str(text)))}</{tag}>"


def quoted(text: str) -> str:
    """Write the value of an attribute, with its quotes."""
    return quoteattr(_NOT_XML.sub("?", text))


def utc(times_s: ArrayLike) -> list[str]:
    """Write times as ISO 8601, to the microsecond, in UTC: `2026-05-01T10:00:00.250000Z`.

    Parameters
    ----------
    times_s : (n,) array_like of float
        Seconds since 1970.

    Returns
    -------
    list of str
    """
    microseconds = np.round(np.asarray(times_s, dtype=np.float64).reshape(-1) * 1e6).astype(np.int64)
    return [f"{time}Z" for time in np.datetime_as_string(microseconds.astype("datetime64[us]")).tolist()]
