"""The running program as users start it: `expmap serve` with a separate library."""

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
    """Run a command to its end and return its output, or raise with its error message."""
    command = [sys.executable, "-m", "webapp", *map(str, words)]
    environ = {**os.environ, "EXPMAP_LIBRARY": str(library)}
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise AssertionError(f"expmap {' '.join(map(str, words))}: {done.returncode}\n{done.stderr}")
    return done.stdout


class App:
    """`expmap serve` as a process; its standard error is kept.

    Parameters
    ----------
    library : Path
        Created if missing.
    port : int
        To listen on at 127.0.0.1; 0 for a free one.
    environ : mapping, optional
        More environment variables.
    """

    def __init__(self, library: Path, *, port: int = 0, environ: dict[str, str] | None = None) -> None:
        self.library = library
        self.environ = environ or {}
        self.port = port
        self.url = ""
        self.sign_in = ""
        """One-time sign-in link of the owner; empty if the start printed none."""
        self.said: deque[str] = deque(maxlen=2000)
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "App":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Return the id of the started process, the parent of all others."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start it, and wait until it responds."""
        words = ["serve", "--host", "127.0.0.1", "--port", str(self.port), "--library", str(self.library)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "webapp", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **self.environ},
            start_new_session=os.name != "nt",  # Ctrl-C in the terminal should only reach the tests
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
        """Stop it as by Ctrl-C, and return the exit code."""
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
