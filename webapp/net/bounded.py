"""GET requests and downloads with limits of bytes and time, which hold whatever a server sends.

The timeout of `requests` is that of one read from the socket, so that a byte now and then keeps a request
open for ever, and nobody counts the bytes of headers, chunk sizes and trailers. Here the limits apply at the
socket.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from http.client import HTTPResponse
from typing import Any

import requests
from requests.adapters import HTTPAdapter
from urllib3 import HTTPConnectionPool, HTTPSConnectionPool
from urllib3.connection import HTTPConnection, HTTPSConnection

from webapp import __version__
from webapp.errors import InputError
from webapp.progress import Progress

CHUNK = 65_536
_SLOWEST = 5_000.0
"""Bytes per second that a server has to send, after a start."""

_START = 2.0
"""Time for this start and for the headers, in timeouts."""

_AROUND = 1_000_000
"""Bytes around a body of the largest size: headers, sizes of chunks, trailers."""

_most_bytes: ContextVar[int] = ContextVar("most_bytes")


class BoundedAdapter(HTTPAdapter):
    """Adapter for sessions that `answering` uses; options as for `HTTPAdapter`."""

    def init_poolmanager(self, *args: Any, **options: Any) -> None:
        """Create the pools of connections."""
        super().init_poolmanager(*args, **options)
        self.poolmanager.pool_classes_by_scheme = _POOLS

    def proxy_manager_for(self, *args: Any, **options: Any) -> Any:
        """Create the pools of connections to a proxy."""
        manager = super().proxy_manager_for(*args, **options)
        manager.pool_classes_by_scheme = _POOLS
        return manager


def bounded_session(user_agent: str, adapter: HTTPAdapter | None = None) -> requests.Session:
    session = requests.Session()
    session.headers["User-Agent"] = user_agent
    adapter = adapter or BoundedAdapter()
    for scheme in ("https://", "http://"):
        session.mount(scheme, adapter)
    return session


@contextmanager
def answering(
    session: requests.Session,
    address: str,
    *,
    most_bytes: int,
    timeout_s: float,
    headers: Mapping[str, str] | None = None,
    params: Mapping[str, str] | None = None,
) -> Iterator[requests.Response]:
    """Send a GET request; redirects are not followed, as they could lead to a host that nobody has agreed to.

    Args:
        most_bytes: Maximum size of the body.
        timeout_s: Longest wait for a part of the answer. The headers may take twice as long, and the whole
            answer the time that its bytes take at 5 kB/s in addition.

    Raises:
        requests.RequestException: There is no answer, or it exceeds the limits.
    """
    with (
        bounded(most_bytes),
        session.get(
            address,
            headers=headers,
            params=params,
            timeout=timeout_s,
            stream=True,
            allow_redirects=False,
        ) as answer,
    ):
        yield answer


@contextmanager
def bounded(most_bytes: int) -> Iterator[None]:
    """Limit the answers to requests of the block: their time, and their body to some bytes."""
    token = _most_bytes.set(most_bytes)
    try:
        yield
    finally:
        _most_bytes.reset(token)


def body(
    answer: requests.Response, *, most_bytes: int, at_chunk: Callable[[], object] = lambda: None
) -> bytes | None:
    """Read the body of an answer; None if it has more bytes than allowed, which are then not read.

    Args:
        at_chunk: Called for every 2^16 bytes; what it raises ends the reading.
    """
    data = bytearray()
    for chunk in answer.iter_content(CHUNK):
        at_chunk()
        data += chunk
        if len(data) > most_bytes:
            return None
    return bytes(data)


class _BoundedRaw(io.RawIOBase):
    """Reads from a socket until its budget of bytes and time is spent."""

    def __init__(self, raw: io.RawIOBase, sock: Any) -> None:
        self._raw, self._sock = raw, sock
        self._timeout_s: float = sock.gettimeout()
        self._since = time.monotonic()
        self._left = _most_bytes.get() + _AROUND
        self._received = 0
        self.in_body = False

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        earned_s = self._received / _SLOWEST if self.in_body else 0.0
        left_s = self._since + _START * self._timeout_s + earned_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("the answer takes too long")
        if self._received > self._left:
            raise OSError("the answer is too long")
        self._sock.settimeout(min(left_s, self._timeout_s))
        count = self._raw.readinto(buffer)
        self._received += count or 0
        return count

    def close(self) -> None:
        self._raw.close()
        super().close()


class _BoundedResponse(HTTPResponse):
    """A response that is read through `_BoundedRaw`."""

    def __init__(self, sock: Any, *args: Any, **options: Any) -> None:
        super().__init__(sock, *args, **options)
        self._bounded = _BoundedRaw(self.fp.detach(), sock)
        self.fp = io.BufferedReader(self._bounded)

    def begin(self) -> None:
        super().begin()
        self._bounded.in_body = True


class BoundedConnection(HTTPConnection):
    response_class = _BoundedResponse


class BoundedSecureConnection(HTTPSConnection):
    response_class = _BoundedResponse


class _Pool(HTTPConnectionPool):
    ConnectionCls = BoundedConnection


class _SecurePool(HTTPSConnectionPool):
    ConnectionCls = BoundedSecureConnection


_POOLS = {"http": _Pool, "https": _SecurePool}


_USER_AGENT = f"experience-map/{__version__}"
_TIMEOUT_S = 20.0
_HINT = "try again later, or copy the file to this machine yourself and give its folder with --from"


def download(address: str, *, size: int, progress: Progress) -> bytes:
    """Fetch a file.

    Args:
        size: Expected size in bytes; reading stops beyond it.

    Returns:
        Of the right size; the caller has to check the content.

    Raises:
        InputError: The host does not answer, or not with a file of this size.
    """
    progress.size(-(-size // CHUNK))

    def advance() -> None:
        progress.check()
        progress.advance()

    try:
        with (
            bounded_session(_USER_AGENT) as session,
            answering(session, address, most_bytes=size, timeout_s=_TIMEOUT_S) as answer,
        ):
            if answer.status_code != requests.codes.ok:
                raise InputError(f"the host answered {answer.status_code}", where=address, hint=_HINT)
            data = body(answer, most_bytes=size, at_chunk=advance)
    except requests.RequestException as error:
        message = f"the host cannot be reached ({type(error).__name__})"
        raise InputError(message, where=address, hint=_HINT) from error
    if data is None or len(data) != size:
        received = "more" if data is None else len(data)
        raise InputError(f"expected {size} bytes, received {received}", where=address, hint=_HINT)
    return data
