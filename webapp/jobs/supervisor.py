"""Keeps processes running: starts them, starts again what dies, stops them all."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from types import FrameType

_log = logging.getLogger(__name__)

_TICK_S = 0.1
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.25, 5.0
_WELL_S = 5.0
"""A process that has lived so long counts as well started."""

_STDERR = 2


class Child:
    """A process that is meant to run all the time.

    Parameters
    ----------
    name : str
        For the log.
    environment : mapping or None
        Of the process; None for that of this one.
    fds : sequence of int
        File descriptors it inherits.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        environment: Mapping[str, str] | None = None,
        fds: Sequence[int] = (),
    ) -> None:
        self.name = name
        self.failures = 0
        self._command = list(command)
        self._environment = environment
        self._fds = tuple(fds)
        self._process: subprocess.Popen[bytes] | None = None
        self._started_at = self._start_at = 0.0

    def tend(self) -> None:
        """Start the process if it does not run, after a pause that grows while it dies again and again."""
        now = time.monotonic()
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return
            self._signal_all(self._process, signal.SIGTERM)  # requests under way may end in peace
            self._process = None
            self.failures = 1 if now - self._started_at > _WELL_S else self.failures + 1
            pause = min(_FIRST_PAUSE_S * 2 ** (self.failures - 1), _LONGEST_PAUSE_S)
            self._start_at = now + pause
            _log.warning("%s ended (%s); it is started again", self.name, _reason(code))
        if now >= self._start_at:
            self._start()

    def _start(self) -> None:
        # In a session of its own: Ctrl-C in the terminal reaches the supervisor alone, which stops all in
        # turn. Standard output is left to the supervisor.
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stdout=_STDERR,
            env=self._environment,
            pass_fds=self._fds,
            start_new_session=True,
        )
        self._started_at = time.monotonic()

    def ask_to_stop(self) -> None:
        """Send SIGTERM."""
        if self._process is not None:
            self._process.terminate()

    def wait(self, until: float) -> None:
        """Wait until the process has ended, and kill it when the time (monotonic, seconds) has come."""
        if self._process is None:
            return
        try:
            self._process.wait(max(until - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            _log.warning("%s does not stop, and is killed", self.name)
        self._signal_all(self._process, signal.SIGKILL)
        self._process.wait()

    @staticmethod
    def _signal_all(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
        """Send a signal to what is left of the process and of those it has started."""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)


def keep_running(children: Sequence[Child], *, each_tick: Callable[[], None], stop_s: float) -> None:
    """Keep processes running until SIGINT, SIGTERM or SIGHUP.

    Parameters
    ----------
    each_tick : callable
        Called ten times a second; an error from it ends all.
    stop_s : float
        The processes have so many seconds to stop before they are killed.
    """
    stopping = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    try:
        while not stopping.wait(_TICK_S):
            for child in children:
                child.tend()
            each_tick()
    finally:
        for child in children:
            child.ask_to_stop()
        until = time.monotonic() + stop_s
        for child in children:
            child.wait(until)


def _reason(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"
