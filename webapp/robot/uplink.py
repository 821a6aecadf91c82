"""Requests to the server, with the standard library alone."""

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
class Answer:
    """What the server said.

    Attributes
    ----------
    status : int
    body : dict
        Empty where it was no JSON object.
    retry_after_s : float
        Seconds that the server asked to wait; 0 where it did not.
    location : str or None
        Where it sends on to.
    """

    status: int
    body: dict[str, Any]
    retry_after_s: float = 0.0
    location: str | None = None

    @property
    def error(self) -> dict[str, Any] | None:
        """The error in the shape of the API; None where it is none of this API's."""
        told = self.body.get("error")
        return told if isinstance(told, dict) and isinstance(told.get("message"), str) else None

    def refusal(self) -> ExpMapError:
        """Give what the server said as an error of ours."""
        error = self.error or {}
        message = str(error.get("message") or f"the server refuses with status {self.status}")
        hint = str(error.get("hint") or "") or None
        if self.location is not None:
            hint = f"give the address that it sends on to: {self.location}"
        return _ERRORS.get(self.status, UsageError)(message, where=error.get("where"), hint=hint)


@dataclass(frozen=True, slots=True)
class NoAnswer:
    """The network is down, or the server is.

    Attributes
    ----------
    reason : str
    broken : bool
        The connection ended before the answer.
    """

    reason: str
    broken: bool

    def refusal(self) -> ExpMapError:
        """Give it as an error."""
        hint = "look at the network and the server, and try again"
        return NotReady(f"the server does not answer: {self.reason}", hint=hint)


class Uplink:
    """One connection to one server, opened again when it breaks. For one thread.

    Parameters
    ----------
    url : str
        `http://host:port` or `https://host`, with the folder of the program where it has one.
    token : str
    timeout_s : float

    Raises
    ------
    UsageError
        This is no address, or no token.
    """

    def __init__(self, url: str, token: str, *, timeout_s: float) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise UsageError(
                f"{url!r} is no address", where="url", hint="write http://HOST:PORT or https://HOST"
            )
        if not token or not token.isascii() or not token.isprintable():
            raise UsageError(
                "this is no token", where="token", hint="expmap account token --name NAME makes one"
            )
        self._path = f"{parts.path.rstrip('/')}/api/v1"
        self._headers = {"Authorization": f"Bearer {token}", "Accept": "application/json"}
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self._connection = kind(parts.hostname, parts.port, timeout=timeout_s)

    def get(self, path: str) -> Answer | NoAnswer:
        """Ask for what is at an address below `/api/v1`."""
        return self._ask("GET", path)

    def post(self, path: str, value: dict[str, Any]) -> Answer | NoAnswer:
        """Send JSON."""
        return self._post_json(path, json.dumps(value).encode("utf-8"))

    def post_batch(self, path: str, *, sender: str, first: int, texts: Sequence[bytes]) -> Answer | NoAnswer:
        """Send records that are JSON already.

        Parameters
        ----------
        path : str
        sender : str
        first : int
            Number of the first record at the server.
        texts : sequence of bytes
        """
        head = json.dumps({"sender": sender, "first": first})[:-1].encode("utf-8")
        return self._post_json(path, b'%s, "records": [%s]}' % (head, b",".join(texts)))

    def post_file(
        self, path: str, file: Path | bytes, *, name: str, fields: dict[str, str]
    ) -> Answer | NoAnswer:
        """Send a file as a form, block by block.

        Parameters
        ----------
        path : str
        file : Path or bytes
        name : str
            Of the file, for people.
        fields : dict of str to str
            What else the form has.
        """
        boundary = secrets.token_hex(16)
        head, tail = _form(boundary, name, fields)
        size = len(file) if isinstance(file, bytes) else file.stat().st_size
        headers = {
            "Content-Type": f"multipart/form-data; boundary={boundary}",
            "Content-Length": str(len(head) + size + len(tail)),
        }
        return self._ask("POST", path, headers=headers, body=lambda: _blocks(file, head, tail=tail))

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _post_json(self, path: str, data: bytes) -> Answer | NoAnswer:
        headers = {"Content-Type": "application/json", "Content-Length": str(len(data))}
        return self._ask("POST", path, headers=headers, body=lambda: [data])

    def _ask(
        self, method: str, path: str, *, headers: dict[str, str] | None = None, body: Any = None
    ) -> Answer | NoAnswer:
        """Ask; once more where the server has closed a connection that was idle."""
        was_open = self._connection.sock is not None
        told = self._once(method, path, headers=headers or {}, body=body)
        if isinstance(told, NoAnswer) and told.broken and was_open:
            told = self._once(method, path, headers=headers or {}, body=body)
        return told

    def _once(self, method: str, path: str, *, headers: dict[str, str], body: Any) -> Answer | NoAnswer:
        try:
            data: Iterable[bytes] | None = None if body is None else body()
            self._connection.request(method, self._path + path, body=data, headers=self._headers | headers)
            response = self._connection.getresponse()
            text = response.read(_ANSWER_BYTES)
            if response.will_close or not response.isclosed():
                self._connection.close()
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            return NoAnswer(str(error) or type(error).__name__, isinstance(error, ConnectionError))
        return Answer(
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
    """Read `Retry-After`: seconds, or a date."""
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
