"""HTTP client of a photo library: bounded answers, pauses that it asks for, only hosts that are allowed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import Any

import requests

from webapp import __version__
from webapp.errors import InputError, TooMany
from webapp.net.bounded import body, bounded
from webapp.net.polite import RateLimit, retry_after_s
from webapp.net.public_hosts import public_session
from webapp.settings import LibrarySettings

_USER_AGENT = f"experience-map/{__version__} (photo libraries)"
_MAX_JSON_BYTES = 50_000_000
_PAUSES_S = (0.5, 2.0)
"""Before a request is repeated, unless the library asks for another pause."""

_TRY_AGAIN = (429, 500, 502, 503, 504)
_LISTEN_S = 0.5
_LATER = "try again later: what was fetched is kept"


class LibraryHttp:
    """Sends requests to one photo library.

    Args:
        name: Of the program, for messages.
        site: Its address.
        api: Path of its API there.
        headers: With the API key; sent only there, as redirects are not followed.
        check: Called while waiting; what it raises ends the work.
    """

    def __init__(
        self,
        name: str,
        site: str,
        *,
        api: str,
        headers: Mapping[str, str],
        settings: LibrarySettings,
        check: Callable[[], object] = lambda: None,
    ) -> None:
        self.name, self.site, self._settings, self._check = name, site, settings, check
        self._base = f"{site}{api}"
        self._pace = RateLimit(settings.requests_per_second)
        self._session = public_session(
            _USER_AGENT, allowed=settings.private_hosts, setting="libraries.private_hosts"
        )
        self._session.headers.update(headers)

    def close(self) -> None:
        self._session.close()

    def json(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, str] | None = None,
        content: Mapping[str, Any] | None = None,
    ) -> Any:
        """Send a request and return the JSON of the answer; None for an empty one.

        Raises:
            InputError: The library cannot be reached, refuses, or does not answer with JSON.
            TooMany: It asks for a longer pause than is allowed.
        """
        data = self._fetch(method, path, params=params, content=content, most_bytes=_MAX_JSON_BYTES)
        try:
            return json.loads(data) if data else None
        except (ValueError, RecursionError) as error:
            hint = f"is this the address of {self.name}?"
            raise self.error("did not answer with JSON", hint=hint) from error

    def file(self, path: str, *, params: Mapping[str, str] | None = None, most_bytes: int) -> bytes:
        """Fetch a file; errors as `json`."""
        return self._fetch("GET", path, params=params, content=None, most_bytes=most_bytes)

    def error(self, what: str, *, hint: str | None = None) -> InputError:
        return InputError(f"{self.name} {what}", hint=hint)

    def _fetch(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, str] | None,
        content: Mapping[str, Any] | None,
        most_bytes: int,
    ) -> bytes:
        """Send a request, again after a pause if it fails for a reason that passes."""
        for pause_s in (*_PAUSES_S, None):
            self._pace.wait(self._sleep)
            try:
                with (
                    bounded(most_bytes),
                    self._session.request(
                        method,
                        f"{self._base}{path}",
                        params=params,
                        json=content,
                        timeout=self._settings.timeout_s,
                        stream=True,
                        allow_redirects=False,
                    ) as answer,
                ):
                    if answer.ok and not answer.is_redirect:
                        return self._content(answer, most_bytes)
                    status, wait_s = answer.status_code, retry_after_s(answer.headers.get("Retry-After"))
            except (requests.RequestException, OSError, ValueError) as error:
                if pause_s is None or isinstance(error, ValueError):
                    raise self._unreachable(error) from error
                self._sleep(pause_s)
                continue
            if pause_s is None or status not in _TRY_AGAIN:
                raise self._refusal(status)
            self._wait(wait_s if wait_s is not None else pause_s)
        raise AssertionError("the last try returns or raises")

    def _content(self, answer: requests.Response, most_bytes: int) -> bytes:
        data = body(answer, most_bytes=most_bytes, at_chunk=self._check)
        if data is None:
            raise self.error(f"sent more than {most_bytes / 1e6:.0f} MB")
        return data

    def _refusal(self, status: int) -> InputError:
        if status in (401, 403):
            return self.error(
                f"refuses the API key ({status})",
                hint="make a key with the permissions that the guide names, and connect the library again",
            )
        if 300 <= status < 400:
            return self.error(
                f"redirects ({status}), which is not followed", hint="give the final address of the library"
            )
        return self.error(f"answered {status}", hint=_LATER)

    def _unreachable(self, error: BaseException) -> InputError:
        """Name the innermost error: those around it have the whole address in their texts."""
        while (inner := error.__cause__ or error.__context__) is not None:
            error = inner
        return self.error(
            f"cannot be reached ({type(error).__name__})", hint="check the address, and whether it is running"
        )

    def _wait(self, seconds: float) -> None:
        if seconds > self._settings.patience_s:
            raise TooMany(
                f"{self.name} asks for a pause of {seconds:.0f} seconds", wait_s=int(seconds), hint=_LATER
            )
        self._sleep(seconds)

    def _sleep(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        self._check()
        while (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _LISTEN_S))
            self._check()
