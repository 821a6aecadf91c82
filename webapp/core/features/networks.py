"""OpenCV's networks, lent to one thread at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from threading import Lock
from typing import TypeVar

import cv2

from webapp.threads import Pool

Net = TypeVar("Net")

_alone = Lock()


class Networks(Pool[Net]):
    """Networks of one kind, as many as are used at the same time.

    OpenCV 5.0 crashes now and then where two networks run at once, each on several threads of its own. There
    one runs at a time in the process, of whatever kind; with one native thread each they run side by side.
    """

    @contextmanager
    def lent(self) -> Iterator[Net]:
        """Lend the one that came back last, or a new one; after an error nobody gets it again."""
        with _turn(), super().lent() as net:
            yield net

    @contextmanager
    def renewed(self) -> Iterator[Net]:
        """Lend a new one, which is kept as the others are."""
        with _turn(), super().renewed() as net:
            yield net


def _turn() -> Lock | nullcontext[None]:
    return _alone if cv2.getNumThreads() > 1 else nullcontext()
