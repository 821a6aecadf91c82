"""Kills random processes of the running program without warning."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import threading
from collections import Counter
from collections.abc import Iterator


def descendants(pid: int) -> dict[int, str]:
    """Return the descendants of a process, with their command lines."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True)
    children: dict[int, list[tuple[int, str]]] = {}
    for line in listed.stdout.splitlines():
        child, parent, command = line.split(maxsplit=2)
        children.setdefault(int(parent), []).append((int(child), command))
    return dict(_below(pid, children))


def _below(pid: int, children: dict[int, list[tuple[int, str]]]) -> Iterator[tuple[int, str]]:
    for child, command in children.get(pid, []):
        yield child, command
        yield from _below(child, children)


class Killer:
    """Context manager that kills a random descendant of `pid` every few seconds, with SIGKILL.

    Attributes:
    ----------
    killed : Counter
        Number of kills of each command line.
    """

    def __init__(self, pid: int, *, every_s: float, seed: int = 0) -> None:
        self.killed: Counter[str] = Counter()
        self._pid = pid
        self._every_s = every_s
        self._random = random.Random(seed)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> Killer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Stop killing processes."""
        self._end.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._end.wait(self._every_s):
            found = descendants(self._pid)
            if not found:
                continue
            pid = self._random.choice(sorted(found))
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue  # it ended by itself
            self.killed[found[pid][:60]] += 1
