"""Uploads what a robot has left in its spool."""

from __future__ import annotations

import time
from collections.abc import Callable

from .errors import NotReady
from .options import RobotOptions
from .spool import Spool
from .uplink import Uplink
from .uploader import Backoff, Uploader

_LOOK_S = 0.2


def recover(
    spool: Spool,
    token: str,
    *,
    options: RobotOptions,
    patience_s: float,
    on_progress: Callable[[int], None],
) -> None:
    """Upload everything that is left.

    Parameters
    ----------
    patience_s : float
        Give up when the server has taken nothing for so many seconds.
    on_progress : callable
        Gets the number of records and photos that wait, after each step and a few times a second while it
        waits; what it raises ends the work.

    Raises
    ------
    NotReady
        The network or the server is down.
    ExpMapError
        The server refuses: an unknown token, a deleted mission.
    """
    uplink = Uplink(spool.identity.url, token, timeout_s=options.timeout_s)
    uploader = Uploader(spool, uplink, options=options)
    backoff = Backoff(options.backoff_s, options.backoff_max_s)
    until = time.monotonic() + patience_s
    try:
        while (step := uploader.step()).outcome != "idle":
            on_progress(spool.waiting + spool.photos.count)
            if step.error is not None:
                raise step.error
            if step.outcome == "progress":
                backoff.reset()
                until = time.monotonic() + patience_s
                continue
            again = time.monotonic() + backoff.next_delay(at_least_s=step.wait_s)
            if again > until:
                hint = "what is left stays in the spool: try again later"
                raise NotReady(f"the server refuses everything: {step.reason}", hint=hint)
            while time.monotonic() < again:
                time.sleep(_LOOK_S)
                on_progress(spool.waiting + spool.photos.count)
    finally:
        uplink.close()
