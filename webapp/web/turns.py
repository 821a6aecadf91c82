"""A limit on concurrent requests of a kind; further ones are refused with `Retry-After`."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

from flask import current_app
from flask.blueprints import BlueprintSetupState

from webapp.errors import TooMany
from webapp.web.state import KEY, AppState

_EXTENSION = "expmap_turns"
_WAIT_S = 1


class Turns:
    """Lets a part of the server's threads do one kind of request, so that others are answered too.

    Parameters
    ----------
    name : str
        Of the kind.
    share : float
        Of the threads.
    """

    def __init__(self, name: str, *, share: float) -> None:
        self._name = name
        self._share = share

    def set_up(self, setup: BlueprintSetupState) -> None:
        """Count from now on; for `blueprint.record`."""
        state = cast(AppState, setup.app.extensions[KEY])
        most = max(1, int(state.settings.serve.threads * self._share))
        setup.app.extensions.setdefault(_EXTENSION, {})[self._name] = threading.BoundedSemaphore(most)

    def free(self) -> threading.BoundedSemaphore:
        """Give what holds one permit for each request more that may begin now."""
        return cast(threading.BoundedSemaphore, current_app.extensions[_EXTENSION][self._name])

    @contextmanager
    def one(self) -> Iterator[None]:
        """Take a turn for as long as the block lasts.

        Raises
        ------
        TooMany
            None is free.
        """
        free = self.free()
        if not free.acquire(blocking=False):
            raise TooMany("the server is busy", wait_s=_WAIT_S, hint="repeat the request a little later")
        try:
            yield
        finally:
            free.release()
