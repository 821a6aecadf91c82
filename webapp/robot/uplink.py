"""HTTP requests to the server."""

from __future__ import annotations

import email.utils
import http.client
import io
import json
import secrets
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from .errors import (
    Conflict,
    ExpMapError,
    InputError,
    NotAllowed,
    NotFound,
    NotReady,
    NotSignedIn,
    UsageError,
)

_ANSWER_BYTES = 1 << 20
_BLOCK = 1 << 16
_LONGEST_WAIT_S = 3600.0
_ERRORS: dict[int, type[ExpMapError]] = {
    401: NotSignedIn,
    403: NotAllowed,
    404: NotFound,
    409: Conflict,
    410: NotFound,
    422: InputError,
    429: NotReady,
    503: NotReady,
}


@dataclass(frozen=True, slots=True)
class Response:
    """A response of the server."""

    status: int
    body: dict[str, Any]  # Empty if it was not a JSON object
    retry_after_s: float = 0.0  # From the header `Retry-After`; 0 without one
    location: str | None = None  # Target of a redirect

    @property
    def error(self) -> dict[str, Any] | None:
        """The error object in the format of the API; None if there is none."""
        error = self.body.get("error")
        return error if isinstance(error, dict) and isinstance(error.get("message"), str) else None

    def as_error(self) -> ExpMapError:
        """Convert the response to an exception."""
        error = self.error or {}
        message = str(error.get("message") or f"the server refuses with status {self.status}")
        hint = str(error.get("hint") or "") or None
        if self.location is not None:
            hint = f"use the address that it redirects to: {self.location}"
        return _ERRORS.get(self.status, UsageError)(message, where=error.get("where"), hint=hint)


@dataclass(frozen=True, slots=True)
class NoResponse:
    """No response: the network or the server is down."""

    reason: str
    broken: bool  # The connection was closed before the response

    def as_error(self) -> ExpMapError:
        """Convert the failure to an exception."""
        hint = "check the network and the server, and try again"
        return NotReady(f"the server does not answer: {self.reason}", hint=hint)


class Uplink:
    """A connection to one server, reopened when it breaks. Not thread-safe.

    Args:
        url: `http://host:port` or `https://host`, optionally with a path prefix.

    Raises:
        UsageError: The address or the token is invalid.
    """

    def __init__(self, url: str, token: str, *, timeout_s: float) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise UsageError(
                f"{url!r} is not an address", where="url", hint="write http://HOST:PORT or https://HOST"
            )
        if not token or not token.isascii() or not token.isprintable():
            raise UsageError(
                "this is not a valid token", where="token", hint="expmap account token --name NAME makes one"
            )
        self._path = f"{parts.path.rstrip('/')}/api/v1"
        self._headers = {"Authorization": f"Bearer {token}", "Accept": "application/json"}
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self._connection = kind(parts.hostname, parts.port, timeout=timeout_s)

    def get(self, path: str) -> Response | NoResponse:
        """Send a GET request to a path below `/api/v1`."""
        return self._request("GET", path)

    def post(self, path: str, value: dict[str, Any]) -> Response | NoResponse:
        """Send JSON by POST."""
        return self._post_json(path, json.dumps(value).encode("utf-8"))

    def post_batch(
        self, path: str, *, sender: str, first: int, texts: Sequence[bytes]
    ) -> Response | NoResponse:
        """Send records that are already encoded as JSON.

        Args:
            first: Number of the first record at the server.
        """
        head = json.dumps({"sender": sender, "first": first})[:-1].encode("utf-8")
        return self._post_json(path, b'%s, "records": [%s]}' % (head, b",".join(texts)))

    def post_file(
        self, path: str, file: Path | bytes, *, name: str, fields: dict[str, str]
    ) -> Response | NoResponse:
        """Send a file as a multipart form, block by block.

        Args:
            name: File name, for display.
            fields: Further fields of the form.
        """
        boundary = secrets.token_hex(16)
        head, tail = _form(boundary, name, fields)
        size = len(file) if isinstance(file, bytes) else file.stat().st_size
        headers = {
            "Content-Type": f"multipart/form-data; boundary={boundary}",
            "Content-Length": str(len(head) + size + len(tail)),
        }
        return self._request("POST", path, headers=headers, body=lambda: _blocks(file, head, tail=tail))

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _post_json(self, path: str, data: bytes) -> Response | NoResponse:
        headers = {"Content-Type": "application/json", "Content-Length": str(len(data))}
        return self._request("POST", path, headers=headers, body=lambda: [data])

    def _request(
        self, method: str, path: str, *, headers: dict[str, str] | None = None, body: Any = None
    ) -> Response | NoResponse:
        """Send a request; retry once if the server has closed an idle connection."""
        was_open = self._connection.sock is not None
        response = self._request_once(method, path, headers=headers or {}, body=body)
        if isinstance(response, NoResponse) and response.broken and was_open:
            response = self._request_once(method, path, headers=headers or {}, body=body)
        return response

    def _request_once(
        self, method: str, path: str, *, headers: dict[str, str], body: Any
    ) -> Response | NoResponse:
        try:
            data: Iterable[bytes] | None = None if body is None else body()
            self._connection.request(method, self._path + path, body=data, headers=self._headers | headers)
            response = self._connection.getresponse()
            text = response.read(_ANSWER_BYTES)
            if response.will_close or not response.isclosed():
                self._connection.close()
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            return NoResponse(str(error) or type(error).__name__, isinstance(error, ConnectionError))
        return Response(
            response.status,
            _object(text),
            _seconds(response.headers.get("Retry-After")),
            response.headers.get("Location"),
        )


def _object(text: bytes) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _seconds(text: str | None) -> float:
    """Parse `Retry-After`: seconds, or a date."""
    if text is None:
        return 0.0
    if text.strip().isdecimal():
        return min(float(text), _LONGEST_WAIT_S)
    try:
        until = email.utils.parsedate_to_datetime(text).timestamp()
    except ValueError:
        return 0.0
    return min(max(until - time.time(), 0.0), _LONGEST_WAIT_S)


def _form(boundary: str, name: str, fields: dict[str, str]) -> tuple[bytes, bytes]:
    parts = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{key}"\r\n\r\n{value}\r\n'
        for key, value in fields.items()
    ]
    plain = "".join("_" if char in '"\\\r\n' else char for char in name)
    parts.append(
        f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{plain}"\r\n'
        "Content-Type: application/octet-stream\r\n\r\n"
    )
    return "".join(parts).encode("utf-8"), f"\r\n--{boundary}--\r\n".encode()


def _blocks(file: Path | bytes, head: bytes, *, tail: bytes) -> Iterator[bytes]:
    yield head
    with io.BytesIO(file) if isinstance(file, bytes) else file.open("rb") as source:
        while block := source.read(_BLOCK):
            yield block
    yield tail
