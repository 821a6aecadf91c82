"""HTTP client of one service: limits the request rate, obeys Retry-After, and contacts only allowed hosts."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from urllib.parse import urljoin

import requests
from urllib3.util import Url, parse_url

from webapp import __version__
from webapp.errors import Cancelled, InputError, TooMany
from webapp.net.bounded import BoundedAdapter, answering, body, bounded_session
from webapp.settings import StreetSettings

_USER_AGENT = f"experience-map/{__version__} (photos of one area for a map)"
_MAX_JSON_BYTES = 50_000_000
_TRIES = 4
_REDIRECTS = 3
_TRY_AGAIN = (429, 500, 502, 503, 504)
_REFUSED = (401, 403)
_LONGEST_S = 1e9
"""Upper limit of a pause that a service demands, to keep it finite."""
_WHERE = "street-level photos"
_LATER = "try again later: what was fetched is kept"


class RateLimit:
    """Limits the rate of requests over all threads."""

    def __init__(self, per_second: float) -> None:
        self._lock = threading.Lock()
        self._gap = 1.0 / per_second
        self._next = 0.0

    def wait(self, sleep: Callable[[float], object]) -> None:
        """Wait until the next request is allowed."""
        with self._lock:
            now = time.monotonic()
            at = max(self._next, now)
            self._next = at + self._gap
        sleep(at - now)

    def pause(self, seconds: float) -> None:
        """Allow no request for this time."""
        with self._lock:
            self._next = max(self._next, time.monotonic() + seconds)


class PoliteClient:
    """Sends requests to one service, and to the hosts of its photos.

    Args:
        headers: For the service itself only: a token must not be sent to other hosts.
    """

    def __init__(
        self, name: str, base: str, *, headers: Mapping[str, str] | None = None, settings: StreetSettings
    ) -> None:
        self._name, self._headers = name, dict(headers or {})
        try:
            self._origin = _origin(base)
        except ValueError as error:
            raise self._error(f"has an invalid address: {base}", hint="see the settings") from error
        self._hosts = tuple(host.strip().lower() for host in settings.photo_hosts.split(",") if host.strip())
        self._settings = settings
        self._pace = RateLimit(settings.requests_per_second)
        self._stopped = threading.Event()
        self._session = bounded_session(_USER_AGENT, BoundedAdapter(pool_maxsize=settings.parallel))
        self._session.trust_env = False  # do not send passwords of a .netrc

    def stop(self) -> None:
        """Cancel pending requests, also those of other threads; later requests are refused."""
        self._stopped.set()
        self._session.close()

    def json(self, address: str) -> object:
        """Request JSON from the service itself.

        Raises:
            InputError: It does not answer, refuses, or does not send JSON.
            TooMany: It demands a longer pause than is allowed.
            Cancelled: `stop` was called.
        """
        if not self._is_own(address):
            raise self._error("leads to another host", hint="check its address")
        data = self._fetch(address, max_bytes=_MAX_JSON_BYTES)
        try:
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            raise self._error("did not send a list of photos") from error

    def photo(self, address: str, *, max_bytes: int) -> bytes:
        """Fetch a photo; errors as `json`, and InputError if its host is not allowed."""
        return self._fetch(address, max_bytes=max_bytes)

    def may_fetch(self, address: str) -> bool:
        try:
            parts = _parse(address)
        except ValueError:
            return False
        host = (parts.host or "").lower()
        named = any(host == own or host.endswith(f".{own}") for own in self._hosts)
        return (parts.scheme, parts.netloc) == self._origin or (parts.scheme == "https" and named)

    def _fetch(self, address: str, *, max_bytes: int) -> bytes:
        """Fetch with retries, after growing pauses or those that the service demands."""
        for turn in range(1, _TRIES + 1):
            self._pace.wait(self._sleep)
            try:
                answer = self._answer(address, max_bytes=max_bytes)
            except requests.RequestException as error:
                if turn == _TRIES:
                    raise self._error(f"cannot be reached ({type(error).__name__})", hint=_LATER) from error
                self._pace.pause(2.0 ** (turn - 2))
                continue
            if isinstance(answer, bytes):
                return answer
            if answer.status_code in _REFUSED:
                hint = "check its token in the settings" if self._headers else "it may require an account"
                raise self._error(f"refused access ({answer.status_code})", hint=hint)
            if answer.status_code not in _TRY_AGAIN or turn == _TRIES:
                raise self._error(f"answered {answer.status_code}", hint=_LATER)
            self._wait_as_asked(answer, otherwise_s=2.0 ** (turn - 2))
        raise AssertionError("the last try returns or raises")

    def _answer(self, address: str, *, max_bytes: int) -> bytes | requests.Response:
        """Send one request; return the content, or the response if it is an error."""
        for _ in range(_REDIRECTS + 1):
            if not self.may_fetch(address):
                raise self._error(
                    f"has a photo on the host {_host(address)}, which is not allowed",
                    hint="add it to street.photo_hosts if you trust it",
                )
            with answering(
                self._session,
                address,
                headers=self._headers if self._is_own(address) else {},
                most_bytes=max_bytes,
                timeout_s=self._settings.timeout_s,
            ) as answer:
                if answer.is_redirect:
                    address = self._next_address(address, answer.headers["Location"])
                    continue
                return self._content(answer, max_bytes) if answer.ok else answer
        raise self._error("redirects too many times")

    def _is_own(self, address: str) -> bool:
        try:
            return _origin(address) == self._origin
        except ValueError:
            return False

    def _next_address(self, address: str, location: str) -> str:
        try:
            return urljoin(address, location)
        except ValueError as error:
            raise self._error("redirects to an invalid address") from error

    def _content(self, answer: requests.Response, max_bytes: int) -> bytes:
        data = body(answer, most_bytes=max_bytes, at_chunk=self._check)
        if data is None:
            raise self._error(f"sent more than {max_bytes / 1e6:.0f} MB")
        return data

    def _wait_as_asked(self, answer: requests.Response, *, otherwise_s: float) -> None:
        wait_s = retry_after_s(answer.headers.get("Retry-After"))
        if wait_s is not None and wait_s > self._settings.patience_s:
            raise TooMany(
                f"{self._name} asks for a pause of {wait_s:.0f} seconds",
                wait_s=int(wait_s),
                where=_WHERE,
                hint=_LATER,
            )
        self._pace.pause(otherwise_s if wait_s is None else wait_s)

    def _sleep(self, seconds: float) -> None:
        self._stopped.wait(seconds)
        self._check()

    def _check(self) -> None:
        if self._stopped.is_set():
            raise Cancelled("stopped; what was finished is kept")

    def _error(self, what: str, *, hint: str | None = None) -> InputError:
        return InputError(f"{self._name} {what}", where=_WHERE, hint=hint)


def _parse(address: str) -> Url:
    """Parse an address as the HTTP library does: another parser could find another host in it.

    Raises:
        ValueError: It is not an address, or has credentials, or characters on which parsers disagree.
    """
    if "\\" in address or not address.isascii() or not address.isprintable():
        raise ValueError(address)
    parts = parse_url(address)
    if parts.host is None or parts.auth is not None:
        raise ValueError(address)
    return parts


def _origin(address: str) -> tuple[str | None, str | None]:
    parts = _parse(address)
    return parts.scheme, parts.netloc


def _host(address: str) -> str:
    try:
        return _parse(address).host or "?"
    except ValueError:
        return "?"


def retry_after_s(text: str | None) -> float | None:
    """Parse the header Retry-After, which is in seconds or a date; None if it is neither."""
    if text is None:
        return None
    if text.strip().isdecimal():
        return min(float(text), _LONGEST_S)
    try:
        at = parsedate_to_datetime(text)
    except ValueError:
        return None
    at = at if at.tzinfo else at.replace(tzinfo=UTC)
    return max(0.0, (at - datetime.now(UTC)).total_seconds())
