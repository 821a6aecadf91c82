"""JSON that is costly or impossible to read: deep, long, with many digits, with halves of surrogate pairs."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

from benchmarks.hostile_inputs import Request

_SIZES = (1_000, 100_000, 4_000_000, 15_000_000)
"""Bytes of a body."""

_ITEMS = (b"1", b"{}", b"[]", b'""', b"null", b'{"id":1}', b"[1,2]")
_ENDLESS = (b"[", b'{"a":', b'[{"a":', b"-", b"9", b'\\"', b"1.")
_ODD = (
    b"NaN", b"-Infinity", b"1e999999999", b"1" + b"0" * 4301, b"0." + b"1" * 4301, b'"\\ud800"',
    b'{"\\udfff":1}', b'{"a":1,"a":2}', b'"\xff"', b'"\\u0000"', b"\xef\xbb\xbf1", b"",
)  # fmt: skip


def json_request(chance: random.Random, document: Mapping[str, Any], *, known: Mapping[str, Any]) -> Request:
    """Make a request with such a body to a random operation that takes JSON.

    Args:
        document: The OpenAPI description.
        known: Existing values, by the names of path parameters.
    """
    method, path, schema = chance.choice(_operations(document))
    for part in path.split("/"):
        if part.startswith("{"):
            path = path.replace(part, str(known.get(part.strip("{}"), 1)))
    field = chance.choice(sorted(schema.get("properties", {"a": {}}))).encode()
    return Request(method, path.removeprefix("/api/v1"), raw=_body(chance, field))


def _operations(document: Mapping[str, Any]) -> list[tuple[str, str, Mapping[str, Any]]]:
    """List the operations that take JSON: method, path and schema."""
    found = []
    for path, operations in sorted(document["paths"].items()):
        for method, operation in sorted(operations.items()):
            content = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if content is not None:
                name = content["schema"].get("$ref", "").rpartition("/")[2]
                schema = document["components"]["schemas"].get(name, content["schema"])
                found.append((method.upper(), path, schema))
    return found


def _body(chance: random.Random, field: bytes) -> bytes:
    size = chance.choice(_SIZES)
    match chance.randrange(5):
        case 0:
            item = chance.choice(_ITEMS)
            value = b"[" + (item + b",") * (size // (len(item) + 1)) + item + b"]"
        case 1:
            item = chance.choice(_ENDLESS)
            value = item * (size // len(item))
        case 2:
            levels = chance.choice((10, 100, 1_000, 100_000))
            value = b"[" * levels + b"]" * levels
        case 3:
            value = b"{" + b",".join(b'"%d":1' % n for n in range(min(size // 12, 50_000))) + b"}"
        case _:
            value = chance.choice(_ODD)
    return chance.choice((value, b'{"' + field + b'":' + value + b"}", b'{"' + field + b'":["' + value))
