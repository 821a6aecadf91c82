"""Chunked uploads: the offset of a chunk, and the response to a wrong one."""

from __future__ import annotations

from typing import Any

from flask import Response, jsonify, request

from webapp.errors import UsageError
from webapp.files.part_file import WrongOffset
from webapp.web.context import settings
from webapp.web.errors import as_json

HEADER = "Upload-Offset"

OPERATION: dict[str, Any] = {
    "parameters": [
        {
            "name": HEADER,
            "in": "header",
            "required": True,
            "description": "Bytes of the file before this chunk.",
            "schema": {"type": "integer", "minimum": 0},
        }
    ],
    "requestBody": {
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    },
}
"""Parameters and body of routes that take a chunk, for the OpenAPI document."""


def chunk_bytes() -> int:
    return int(settings().upload.chunk_mb * 1e6)


def limit_bytes() -> None:
    """Limit the size of chunks, which is enforced while they are read; for `before_request`."""
    if request.method == "PATCH":
        request.max_content_length = chunk_bytes()


def given_offset() -> int:
    """Read the offset of the chunk from the request's header. Raises UsageError."""
    given = request.headers.get(HEADER, "")
    if not (given.isascii() and given.isdecimal() and len(given) < 16):
        raise UsageError(
            "the header with the offset of the chunk is missing",
            where=HEADER,
            hint="send the number of bytes before the chunk",
        )
    return int(given)


def offset_response(error: WrongOffset) -> Response:
    """Make the response with the offset at which to resume; for `errorhandler`."""
    response = jsonify(error=as_json(error), offset=error.offset)
    response.status_code = 409
    response.headers[HEADER] = str(error.offset)
    return response
