"""The JSON of request bodies: limited in bytes, values, depth and digits before it is parsed.

The limits of a route follow from its schema, whose texts and lists all have a maximum length
(`tests/web/test_json_bodies.py`). What exceeds them is refused after a few passes over the bytes; lists that
are too long for their field, before their items are converted (`BoundedList` of `webapp.web.fields`). Callers
without the right that a route needs were refused before (`authorized_by` of `webapp.web.context`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Any, cast

from apiflask import Schema, fields
from apiflask.schema_adapters.marshmallow import parser
from apiflask.validators import Length, OneOf
from flask import Flask, Request, request
from werkzeug.exceptions import RequestEntityTooLarge

from webapp.errors import MapJsonError, UsageError
from webapp.files.json_fields import parse_json
from webapp.web.fields import BoundedDict, BoundedList, JsonValue
from webapp.web.state import settings

_MOST_BYTES, _MOST_VALUES = 16_000_000, 1_000_000
"""Limits of every route, however much its schema allows."""

_SPARE_BYTES, _SPARE_VALUES = 4000, 100
"""Allowance for fields that a route does not know: their names are reported."""

_DEPTH = 20
_DIGITS = 100
_BYTES_PER_CHARACTER = 12
"""Of a character outside the Basic Multilingual Plane, escaped as two surrogates."""

_BYTES_PER_VALUE = 40
"""Allowance for a number and for white space around a value."""

_TEXT = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
"""A text, or the rest of the document where its end is missing; possessive, so that it takes linear time."""

_DIGIT, _OPEN, _CLOSE = b"0", b"[", b"]"
_KINDS = bytes.maketrans(b"123456789+-.eE{}", 14 * _DIGIT + _OPEN + _CLOSE)
"""Maps each character of a number to `_DIGIT`, and brackets to square ones."""
_NO_BRACKETS = bytes(byte for byte in range(256) if byte not in _OPEN + _CLOSE)


@dataclass(frozen=True, slots=True)
class BodyLimits:
    """The most that valid JSON can have."""

    bytes: int
    values: int  # Objects, lists, texts, numbers and so on; names of fields are not counted

    def __add__(self, other: BodyLimits) -> BodyLimits:
        return BodyLimits(self.bytes + other.bytes, self.values + other.values)

    def __mul__(self, times: int) -> BodyLimits:
        return BodyLimits(self.bytes * times, self.values * times)


def init_app(_app: Flask) -> None:
    """Have the JSON of all routes read by `read_json`."""
    parser.location_loader("json")(read_json)


def read_json(request: Request, schema: Schema) -> Any:
    """Read the body of a request within the limits of its schema; an empty object if there is none.

    Raises:
        RequestEntityTooLarge: There are too many bytes or values.
        UsageError: It is not JSON, is nested too deep, or has a number that is too long.
    """
    if not request.is_json:
        return {}
    limits = limits_of(schema)
    request.max_content_length = min(limits.bytes, request.max_content_length or limits.bytes)
    data = request.get_data(cache=False)
    if not data:
        return {}
    _check(data, limits)
    try:
        return parse_json(data, where="body").value
    except MapJsonError as error:
        raise UsageError(error.message, where=error.where, hint="send valid JSON in UTF-8") from error


def _check(data: bytes, limits: BodyLimits) -> None:
    most_texts = 2 * limits.values  # each value may be a text and have a name
    bare, texts = _TEXT.subn(b"", data, count=most_texts + 1)
    bare = bare.translate(_KINDS)
    opened = bare.count(_OPEN)
    if texts > most_texts or bare.count(b",") + opened >= limits.values:
        raise RequestEntityTooLarge
    if _DIGIT * (_DIGITS + 1) in bare:
        raise UsageError("a number in the JSON is too long", where="body", hint=f"at most {_DIGITS} digits")
    # in valid JSON, the last bracket that opens is among the first 2 * opened
    brackets = bare.translate(None, _NO_BRACKETS)[: 2 * opened]
    if max(accumulate(1 if byte == _OPEN[0] else -1 for byte in brackets), default=0) > _DEPTH:
        raise UsageError("the JSON is nested too deep", where="body", hint=f"at most {_DEPTH} levels")


@cache
def limits_of(schema: Schema) -> BodyLimits:
    whole = _of_schema(schema) + BodyLimits(_SPARE_BYTES, _SPARE_VALUES)
    return BodyLimits(min(whole.bytes, _MOST_BYTES), min(whole.values, _MOST_VALUES))


def _of_schema(schema: Schema) -> BodyLimits:
    total = BodyLimits(_BYTES_PER_VALUE, 1)
    for name, field in schema.load_fields.items():
        total += BodyLimits(len(field.data_key or name) + _BYTES_PER_VALUE, 0) + _of_field(field)
    return total


def _of_field(field: fields.Field[Any]) -> BodyLimits:
    own = BodyLimits(_BYTES_PER_VALUE, 1)
    match field:
        case fields.Nested():
            return _of_schema(cast(Schema, field.schema))
        case BoundedList():
            return own + _of_field(field.inner) * field.most
        case BoundedDict():
            return own + (_of_field(field.key) + _of_field(field.value)) * field.most
        case JsonValue():
            return BodyLimits(field.bytes, field.values)
        case fields.String():
            return own + BodyLimits(longest(field.validators) * _BYTES_PER_CHARACTER, 0)
        case fields.Integer() | fields.Float() | fields.Boolean():
            return own
    raise TypeError(f"{field!r} has no limit")


def longest(validators: Sequence[Any]) -> int:
    """Return the maximum length of a text that passes validators."""
    for validator in validators:
        if isinstance(validator, OneOf):
            return max(len(str(choice)) for choice in validator.choices)
        if isinstance(validator, Length) and (most := validator.equal or validator.max) is not None:
            return most
    raise TypeError("a text has no maximum length")


_OTHER_BYTES = 100_000
"""Allowance for the other fields of a form."""
_GEOREFERENCE_BYTES = 1_000_000
"""Allowance for the fields of a form other than an image: its georeference."""


def limit_photo(photos: int = 1) -> None:
    """Limit the request to a form with this many photos."""
    request.max_content_length = int(settings().photo.max_mb * 1e6 * photos) + _OTHER_BYTES


def limit_image() -> None:
    """Limit the request to a form with a satellite image or a plan."""
    if request.method in ("POST", "PUT"):
        request.max_content_length = int(settings().satellite.max_mb * 1e6) + _GEOREFERENCE_BYTES
