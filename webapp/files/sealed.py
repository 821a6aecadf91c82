"""JSON with a checksum of its text, so that a changed digit is damage and not another value."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

_START, _END = b'{"check": "', b'", '
_LENGTH = 16


def sealed(values: Mapping[str, Any]) -> bytes:
    """Write an object with at least one field."""
    rest = json.dumps(values, sort_keys=True).encode()[1:]
    return _START + _check(rest) + _END + rest


def unsealed(data: bytes) -> Any:
    """Parse JSON; without a checksum, as older programs wrote it, it is not checked.

    Raises:
        ValueError: It is not JSON, or differs from its checksum.
    """
    if data.startswith(_START):
        check, rest = data[len(_START) :][:_LENGTH], data[len(_START) + _LENGTH + len(_END) :]
        if _check(rest) != check:
            raise ValueError("it differs from its checksum")
    return json.loads(data)


def _check(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest()[:_LENGTH].encode()
