"""Runs programs one at a time, and measures wall time, CPU time, and peak memory of each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Run:
    """A program that has ended.

    Attributes:
    ----------
    printed : Any
        The JSON that it printed.
    seconds, cpu_seconds : float
        Wall time; CPU time of all cores, including child processes.
    peak_rss_mb : float
        Largest memory of one of its processes, 2^20 bytes, including mapped files.
    private_mb : float or None
        The same of the process itself without mapped files, from `/proc` every 20 ms; None if there is none.
    load : float
        Load average of the minute before it was started.
    """

    printed: Any
    seconds: float
    cpu_seconds: float
    peak_rss_mb: float
    private_mb: float | None
    load: float


class ProgramFailed(Exception):
    """A program ended with an unexpected exit code."""

    def __init__(self, command: Sequence[str], code: int, messages: str) -> None:
        super().__init__(f"{' '.join(command)} ended with {code}:\n{messages}")
        self.code = code
        self.messages = messages


class _PrivateMemory(threading.Thread):
    """Follows the anonymous memory of a process until it has ended."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self._status, self._ended = Path(f"/proc/{pid}/status"), threading.Event()
        self._most_kb = 0

    def run(self) -> None:
        while not self._ended.wait(0.02):
            try:
                found = self._status.read_text().partition("RssAnon:")[2].split()
            except OSError:
                return
            if found:  # not of a process that is ending
                self._most_kb = max(self._most_kb, int(found[0]))

    def most_mb(self) -> float | None:
        """Stop, and return the largest value."""
        self._ended.set()
        self.join()
        return self._most_kb / 1024 or None


def run(command: Sequence[str], *, accepted: Collection[int] = (0,), one_heap: bool = False) -> Run:
    """Run a program to its end. Linux and macOS only.

    The measured peak of a new process is at least the size of its parent, so the caller must stay small and
    import neither NumPy nor OpenCV.

    Parameters
    ----------
    command : sequence of str
    accepted : collection of int
        Exit codes that do not count as failures.
    one_heap : bool
        Whether all threads share one heap of glibc, for figures of memory that can be repeated: else each may
        keep a heap of freed arrays, and how many are filled depends on when threads meet, tens of MB apart.

    Raises:
    ------
    ProgramFailed
    """
    shown = (
        command[1:]
        if len(command) < 14
        else [*command[1:9], f"... {len(command) - 12} more ...", *command[-3:]]
    )
    print("running", *shown, file=sys.stderr, flush=True)
    load, started = os.getloadavg()[0], time.perf_counter()
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as messages:
        environment = {**os.environ, "MALLOC_ARENA_MAX": "1"} if one_heap else None
        process = subprocess.Popen(command, stdout=output, stderr=messages, env=environment)
        private = _PrivateMemory(process.pid)
        private.start()
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        private_mb = private.most_mb()
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        messages.seek(0)
        if process.returncode not in accepted:
            raise ProgramFailed(command, process.returncode, messages.read())
        printed = json.load(output)
    unit = 1 if sys.platform == "darwin" else 1024
    return Run(
        printed, seconds, used.ru_utime + used.ru_stime, used.ru_maxrss * unit / 2**20, private_mb, load
    )
