"""The query parameters of features (OGC API - Features, Part 1): area, time, and part of the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.connect.gis.cql2 import MAX_CHARACTERS, Filter, Kind, parse_filter
from webapp.errors import UsageError
from webapp.files.exchange.times import unix_time

MOST_ITEMS = 10_000
USUAL_ITEMS = 100
_LONGEST = 300
"""Characters of a parameter."""

_LONG = {"filter": MAX_CHARACTERS}

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
_LANGUAGE = "cql2-text"

ITEM_PARAMETERS: tuple[dict[str, Any], ...] = (
    {
        "name": "bbox",
        "in": "query",
        "style": "form",
        "explode": False,
        "description": "West, south, east, north, degrees; or with heights, which do not count. West may be "
        "larger than east: the area crosses the 180th meridian.",
        "schema": {
            "type": "array",
            "items": {"type": "number"},
            "oneOf": [{"minItems": 4, "maxItems": 4}, {"minItems": 6, "maxItems": 6}],
        },
    },
    {
        "name": "datetime",
        "in": "query",
        "description": "A time, or two with `/` between them; `..` is open. Times without a zone are UTC.",
        "schema": {"type": "string"},
        "example": "2026-05-01T00:00:00Z/..",
    },
    {
        "name": "limit",
        "in": "query",
        "description": "Maximum number of features in the answer.",
        "schema": {"type": "integer", "minimum": 1, "maximum": MOST_ITEMS, "default": USUAL_ITEMS},
    },
    {
        "name": "filter",
        "in": "query",
        "description": "Condition on the queryables of the collection, in CQL2 text (Basic CQL2).",
        "schema": {"type": "string", "maxLength": MAX_CHARACTERS},
        "example": "heading_deg < 90 AND NOT note IS NULL",
    },
    {
        "name": "filter-lang",
        "in": "query",
        "description": "The language of the filter, of which there is one.",
        "schema": {"type": "string", "enum": [_LANGUAGE]},
    },
    {
        "name": "filter-crs",
        "in": "query",
        "description": "The coordinate system of the filter, of which there is one.",
        "schema": {"type": "string", "enum": [CRS84]},
    },
    {
        "name": "after",
        "in": "query",
        "description": "Id of the feature after which the answer begins; links `next` have it.",
        "schema": {"type": "string", "maxLength": _LONGEST},
    },
)
COMMON_PARAMETERS = tuple(
    one for one in ITEM_PARAMETERS if one["name"] in {"bbox", "datetime", "limit", "after"}
)
FORMAT_PARAMETER: dict[str, Any] = {
    "name": "f",
    "in": "query",
    "description": "The format, of which there is one.",
    "schema": {"type": "string", "enum": ["json"]},
}

Box = tuple[float, float, float, float]
"""West, south, east, north."""

Region = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]
"""Returns whether it has points, given their latitudes and longitudes, (n,)."""


@dataclass(frozen=True, slots=True)
class ItemQuery:
    """Which features are wanted. Those without a position or a time are in every area and at every time."""

    box: Box | None = None
    span_s: tuple[float, float] | None = None  # Unix seconds, both included; infinite if open
    limit: int = USUAL_ITEMS
    after: str | None = None
    filter: Filter | None = None
    region: Region | None = None

    def in_region(self, region: Region) -> ItemQuery:
        return replace(self, region=region)

    def wants(self, feature: Mapping[str, Any]) -> bool:
        """Return whether the filter, if any, holds for the id and the properties of a feature."""
        return self.filter is None or bool(self.filter({**feature["properties"], "id": feature["id"]}))

    def within(self, lat: ArrayLike, lon: ArrayLike) -> NDArray[np.bool_]:
        """Return whether points (n,) are wanted by their positions, (n,); NaN is unknown."""
        y, x = np.asarray(lat, np.float64), np.asarray(lon, np.float64)
        wanted = np.ones(y.shape, np.bool_) if self.region is None else self.region(y, x)
        if self.box is not None:
            west, south, east, north = self.box
            across = (west <= x) & (x <= east) if west <= east else (west <= x) | (x <= east)
            wanted &= across & (south <= y) & (y <= north)
        return np.asarray(wanted | np.isnan(x) | np.isnan(y))

    def touches(self, box: Box | None) -> bool:
        """Return whether an area is wanted by its position."""
        if self.box is None or box is None:
            return True
        west, south, east, north = self.box
        meets = (west <= box[2] and box[0] <= east) if west <= east else (west <= box[2] or box[0] <= east)
        return meets and south <= box[3] and box[1] <= north

    def during(self, first_s: float | None, last_s: float | None) -> bool:
        """Return whether something that began and ended at these times is wanted; NaN is unknown, too."""
        if self.span_s is None or first_s is None or last_s is None:
            return True
        return not (last_s < self.span_s[0] or self.span_s[1] < first_s)


def parse_items(given: Mapping[str, Sequence[str]], queryables: Mapping[str, Kind]) -> ItemQuery:
    """Parse the parameters of features.

    Args:
        given: Values by name.
        queryables: Properties that a filter may name.

    Raises:
        UsageError: A parameter is unknown, repeated or not valid.
    """
    values = checked(given, {"f", *(parameter["name"] for parameter in ITEM_PARAMETERS)})
    for name, only in (("filter-lang", _LANGUAGE), ("filter-crs", CRS84)):
        if values.get(name, only) != only:
            raise UsageError("this is not implemented", where=name, hint=f"use {only}")
    wanted = parse_filter(values["filter"], queryables) if "filter" in values else None
    return replace(parse_common(values), filter=wanted)


def parse_common(values: Mapping[str, str]) -> ItemQuery:
    """Parse area, time and part of the result. Raises UsageError."""
    return ItemQuery(
        box=_box(values["bbox"]) if "bbox" in values else None,
        span_s=_span(values["datetime"]) if "datetime" in values else None,
        limit=_limit(values.get("limit", str(USUAL_ITEMS))),
        after=values.get("after"),
    )


def checked(
    given: Mapping[str, Sequence[str]], known: set[str], *, long: Mapping[str, int] = _LONG
) -> dict[str, str]:
    """Return the parameters of an address, each once; as the standard demands, an unknown one is an error.

    Args:
        given: Values by name.
        known: Names that exist.
        long: Maximum number of characters of those that may be long.

    Raises:
        UsageError: A parameter is unknown, repeated or too long, or the format is.
    """
    for name, values in given.items():
        if name not in known:
            raise UsageError(
                "this parameter does not exist here", where=name[:80], hint=f"use {', '.join(sorted(known))}"
            )
        if len(values) > 1 or len(values[0]) > long.get(name, _LONGEST):
            raise UsageError("this parameter is there twice, or too long", where=name)
    found = {name: values[0] for name, values in given.items()}
    if found.get("f", "json") != "json":
        raise UsageError("unknown format", where="f", hint="use json")
    return found


def _box(text: str) -> Box:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 6:
        numbers = [*numbers[:2], *numbers[3:5]]
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or numbers[1] > numbers[3]:
        raise UsageError(
            "this is no area", where="bbox", hint="use west,south,east,north in degrees: 14.4,50.0,14.5,50.1"
        )
    west, south, east, north = numbers
    return (-180.0, south, 180.0, north) if east - west >= 360.0 else (west, south, east, north)


def _span(text: str) -> tuple[float, float]:
    first, slash, last = text.partition("/")
    begin = -math.inf if slash and first in ("", "..") else unix_time(first)
    end = math.inf if slash and last in ("", "..") else unix_time(last) if slash else begin
    if not begin <= end or begin == -end == -math.inf:
        raise UsageError(
            "this is neither a time nor an interval",
            where="datetime",
            hint="use 2026-05-01T10:00:00Z, 2026-05-01T00:00:00Z/.. or two times",
        )
    return begin, end


def _limit(text: str) -> int:
    if not text.isascii() or not text.isdecimal() or len(text) > 18 or int(text) < 1:
        raise UsageError("this is no number of features", where="limit", hint=f"use 1 to {MOST_ITEMS}")
    return min(int(text), MOST_ITEMS)
