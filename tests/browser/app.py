"""The running program, as a person starts it: `expmap serve` with a library of its own."""

import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import IO

STARTS_WITHIN_S = 180
STOPS_WITHIN_S = 90
SIGN_IN = re.compile(r"sign in: (\S+)")
LISTENING = re.compile(r"listening on (\S+)")


def expmap(*words: str | Path, library: Path) -> str:
    """Run a command of the program to its end; gives what it printed, or raises with what it said."""
    command = [sys.executable, "-m", "webapp", *map(str, words)]
    environ = {**os.environ, "EXPMAP_LIBRARY": str(library)}
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise AssertionError(f"expmap {' '.join(map(str, words))}: {done.returncode}\n{done.stderr}")
    return done.stdout


class App:
    """`expmap serve` as a process; what it says on standard error is kept.

    Parameters
    ----------
    library : Path
        Is made where there is none.
    port : int
        Where it listens, on 127.0.0.1; 0 for any that is free.
    environ : mapping, optional
        More environment variables.
    """

    def __init__(self, library: Path, *, port: int = 0, environ: dict[str, str] | None = None) -> None:
        self.library = library
        self.environ = environ or {}
        self.port = port
        self.url = ""
        self.sign_in = ""
        """Link that signs the owner in once; empty where the start printed none."""
        self.said: deque[str] = deque(maxlen=2000)
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "App":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Of the process that was started, the parent of all others."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start, and wait until it answers."""
        words = ["serve", "--host", "127.0.0.1", "--port", str(self.port), "--library", str(self.library)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "webapp", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **self.environ},
            start_new_session=os.name != "nt",  # Ctrl-C in the terminal of the tests is for the tests
        )
        printed: queue.Queue[str] = queue.Queue()
        for stream, put in ((self._process.stdout, printed.put), (self._process.stderr, self.said.append)):
            threading.Thread(target=_read, args=(stream, put), daemon=True).start()
        self.url = self._wait(printed, LISTENING).rstrip("/")
        self.sign_in = self._wait(printed, SIGN_IN)

    def _wait(self, printed: "queue.Queue[str]", pattern: re.Pattern[str]) -> str:
        until = time.monotonic() + STARTS_WITHIN_S
        while time.monotonic() < until:
            try:
                line = printed.get(timeout=0.2)
            except queue.Empty:
                assert self._process is not None
                if self._process.poll() is not None:
                    break
                continue
            if found := pattern.search(line):
                return found[1]
        self.stop()
        raise AssertionError(f"expmap serve printed no {pattern.pattern!r}:\n" + "".join(self.said))

    def stop(self) -> int | None:
        """End it as Ctrl-C does; gives its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        process.send_signal(signal.SIGINT)
        try:
            return process.wait(STOPS_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise AssertionError("expmap serve did not stop:\n" + "".join(self.said)) from None
        finally:
            for stream in (process.stdout, process.stderr):
                assert stream is not None
                stream.close()


def _read(stream: IO[str], put: Callable[[str], object]) -> None:
    for line in stream:
        put(line)
