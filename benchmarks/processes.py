"""Runs programs one at a time, and measures wall time, CPU time, and peak memory of each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
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
    load : float
        Load average of the minute before it was started.
    """

    printed: Any
    seconds: float
    cpu_seconds: float
    peak_rss_mb: float
    load: float


class ProgramFailed(Exception):
    """A program ended with an unexpected exit code."""

    def __init__(self, command: Sequence[str], code: int, messages: str) -> None:
        super().__init__(f"{' '.join(command)} ended with {code}:\n{messages}")
        self.code = code
        self.messages = messages


def run(command: Sequence[str], *, accepted: Collection[int] = (0,)) -> Run:
    """Run a program to its end. Linux and macOS only.

    The measured peak of a new process is at least the size of its parent, so the caller must stay small and
    import neither NumPy nor OpenCV.

    Parameters
    ----------
    command : sequence of str
    accepted : collection of int
        Exit codes that do not count as failures.

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
        process = subprocess.Popen(command, stdout=output, stderr=messages)
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        messages.seek(0)
        if process.returncode not in accepted:
            raise ProgramFailed(command, process.returncode, messages.read())
        printed = json.load(output)
    unit = 1 if sys.platform == "darwin" else 1024
    return Run(printed, seconds, used.ru_utime + used.ru_stime, used.ru_maxrss * unit / 2**20, load)
