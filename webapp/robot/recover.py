"""Sends what a robot has left in its spool, and tells what is in one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from webapp.errors import NotReady
from webapp.robot.backoff import Backoff
from webapp.robot.identity import Identity, read_identity
from webapp.robot.options import RobotOptions
from webapp.robot.photos import waiting
from webapp.robot.segments import listed, tail
from webapp.robot.spool import Spool, read_aside, read_state
from webapp.robot.uplink import Uplink
from webapp.robot.uploader import Uploader

_LOOK_S = 0.2


@dataclass(frozen=True, slots=True)
class SpoolContent:
    """What is in a spool.

    Attributes
    ----------
    identity : Identity
    written : int
        Records since it was begun.
    waiting : int
        Of them, how many the server has not acknowledged.
    photos : int
        Photos that wait.
    size : int
        Bytes of records and photos.
    aside : list of dict
        What the server does not have and will not get; see `webapp.robot.spool.read_aside`.
    """

    identity: Identity
    written: int
    waiting: int
    photos: int
    size: int
    aside: list[dict[str, Any]]


def look(folder: Path) -> SpoolContent:
    """Tell what is in a spool, also while a robot writes to it.

    Raises
    ------
    UsageError
        There is none.
    InputError
        It is damaged.
    """
    identity, state, segments = read_identity(folder), read_state(folder), listed(folder)
    written = max(tail(segments[-1]).next, state.sent) if segments else state.sent
    photos = [note.with_suffix(".photo") for note in waiting(folder / "photos")]
    size = sum(path.stat().st_size for path in (*(s.path for s in segments), *photos) if path.exists())
    return SpoolContent(identity, written, written - state.next, len(photos), size, read_aside(folder))


def recover(
    spool: Spool,
    token: str,
    *,
    options: RobotOptions,
    patience_s: float,
    told: Callable[[int], None],
) -> None:
    """Send all that is left.

    Parameters
    ----------
    spool : Spool
    token : str
    options : RobotOptions
    patience_s : float
        Give up when the server has taken nothing for so many seconds.
    told : callable
        Gets the number of records and photos that wait, after each step and a few times a second while it
        waits; what it raises ends the work.

    Raises
    ------
    NotReady
        The network or the server is down.
    ExpMapError
        The server refuses: an unknown token, a mission that is gone.
    """
    uplink = Uplink(spool.identity.url, token, timeout_s=options.timeout_s)
    uploader = Uploader(spool, uplink, options=options)
    backoff = Backoff(options.backoff_s, options.backoff_max_s)
    until = time.monotonic() + patience_s
    try:
        while (step := uploader.step()).outcome != "nothing left":
            told(spool.waiting + spool.photos.count())
            if step.error is not None:
                raise step.error
            if step.outcome == "went on":
                backoff.worked()
                until = time.monotonic() + patience_s
                continue
            again = time.monotonic() + backoff.failed(at_least_s=step.wait_s)
            if again > until:
                hint = "what is left stays in the spool: try again later"
                raise NotReady(f"the server takes nothing: {step.reason}", hint=hint)
            while time.monotonic() < again:
                time.sleep(_LOOK_S)
                told(spool.waiting + spool.photos.count())
    finally:
        uplink.close()
