"""Limits of concurrent requests: of one kind, and of callers who are not signed in."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

from flask import current_app, g, request
from flask.blueprints import BlueprintSetupState
from flask.sansio.app import App

from webapp.errors import Busy, NotSignedIn
from webapp.web.accounts.sessions import forget_caller, signed_in
from webapp.web.state import KEY, AppState

_EXTENSION = "expmap_concurrency"
_WAIT_S = 1


class ConcurrencyLimit:
    """Limits one kind of request to a share of the threads, so that threads are left for others.

    Args:
        share: Share of the threads of a process, 0 to 1.
    """

    def __init__(self, name: str, *, share: float) -> None:
        self._name = name
        self._share = share

    def set_up(self, setup: BlueprintSetupState) -> None:
        """Make the semaphore of an application; for `blueprint.record`."""
        self.init_app(setup.app)

    def init_app(self, app: App) -> None:
        state = cast(AppState, app.extensions[KEY])
        most = max(1, int(state.settings.serve.threads * self._share))
        app.extensions.setdefault(_EXTENSION, {})[self._name] = threading.BoundedSemaphore(most)

    def semaphore(self) -> threading.BoundedSemaphore:
        """Return the semaphore; each request takes a permit."""
        return cast(threading.BoundedSemaphore, current_app.extensions[_EXTENSION][self._name])

    def acquire(self) -> threading.BoundedSemaphore:
        """Take a permit; returns the semaphore, which the caller has to release."""
        free = self.semaphore()
        if not free.acquire(blocking=False):
            raise Busy("the server is busy", wait_s=_WAIT_S, hint="try again in a moment")
        return free

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Hold a permit within the block."""
        free = self.acquire()
        try:
            yield
        finally:
            free.release()


_unauthenticated = ConcurrencyLimit("unauthenticated", share=0.5)


def init_app(app: App) -> None:
    """Limit requests with a body by callers not signed in to half of the threads, before a body is read."""
    _unauthenticated.init_app(app)
    app.before_request(_take_permit)
    app.teardown_request(_release)


def _take_permit() -> None:
    has_body = bool(request.content_length) or "Transfer-Encoding" in request.headers
    if has_body and _is_unauthenticated():
        g.permit_of_unauthenticated = _unauthenticated.acquire()


def _is_unauthenticated() -> bool:
    try:
        return signed_in() is None
    except NotSignedIn:
        forget_caller()  # a view that needs the caller reports the unknown token
        return True


def _release(_error: BaseException | None) -> None:
    permits = g.pop("permit_of_unauthenticated", None)
    if permits is not None:
        permits.release()
