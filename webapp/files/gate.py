"""The gate for files of strangers: they are parsed in a child process with limits of memory and time.

The child is forked by a small process (`webapp.files.gate_child`) that has only imported the readers: forking
takes a few milliseconds, and a process that has loaded OpenCV or faiss cannot be forked safely. The child
sends messages of bytes, which a reader encodes as it likes, but not as pickles: the child is not trusted. It
ends when the caller stops reading, whatever it is doing, and also when the caller is killed.

Systems without `fork` (Windows) have no such limits either: there the reader runs in the process itself.
"""

from __future__ import annotations

import atexit
import json
import logging
import math
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from webapp.errors import ExpMapError, InputError, MissingPart, TableError, TooSlow, TrackError, UsageError
from webapp.importing import import_name
from webapp.progress import Progress
from webapp.settings import FileLimits, environment_for

STARTED, DATA, ERROR, BUG, MEMORY, TIME, END = (bytes([code]) for code in b"SDEXMT.")
"""Kinds of messages; each begins with its kind, and its size as 4 bytes."""

HEAD_BYTES = 5
MAX_MESSAGE = 16_000_000
"""Bytes of one message; larger ones are refused."""

_BLOCK = 1 << 20
_POLL_S = 0.2
"""Interval at which a waiting caller checks whether it was cancelled."""

_PATIENCE = 10.0
"""How long a caller waits for a child, in multiples of the child's CPU time: the machine may be busy."""

_ERRORS = (InputError, TableError, TrackError, UsageError, MissingPart)
_NATIVE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_HINT = "export a part of it, or ask the operator to raise the limit"


@dataclass(frozen=True, slots=True)
class Budget:
    """What reading one file may cost."""

    memory_mb: float  # In addition to what the readers themselves take, megabytes (10^6 bytes)
    cpu_s: float  # Seconds of CPU time
    wait_s: float  # Seconds for which the caller waits for messages, in total


def budget_for(path: Path, limits: FileLimits) -> Budget:
    """Return the budget of a file, or of a folder: CPU time in proportion to its size."""
    cpu_s = limits.cpu_s + limits.cpu_s_per_mb * size_of(path) / 1e6
    return Budget(limits.memory_mb, cpu_s, _PATIENCE * cpu_s)


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def run(
    target: str,
    arguments: Mapping[str, Any],
    *,
    budget: Budget,
    progress: Progress | None = None,
    preload: Collection[str] = (),
    may_write: int | None = 0,
) -> Iterator[bytes]:
    """Call a generator of messages in a child process.

    Args:
        target: "module:function", imported where the child is forked: it must load neither OpenCV nor faiss.
        arguments: Keyword arguments of JSON types.
        preload: Further modules to import before the fork, if they are installed.
        may_write: Largest temporary file, bytes; None for any.

    Raises:
        TooSlow: Reading takes more time than the budget.
        TrackError: Reading takes more memory than the budget, or the reader failed.
        ExpMapError: Whatever the function raises.
    """
    if not hasattr(os, "fork"):
        yield from import_name(target)(**arguments)
        return
    order = {
        "target": target,
        "arguments": dict(arguments),
        "preload": list(preload),
        "memory_bytes": int(budget.memory_mb * 1e6),
        "cpu_s": math.ceil(budget.cpu_s),
        "write_bytes": may_write,
    }
    with _Child(order) as child:
        for kind, data in child.messages(budget, progress or Progress()):
            if kind == DATA:
                yield data
            elif kind == END:
                return
            elif kind != STARTED:
                raise _error(kind, data, budget)


class _Child:
    """A child process; leaving the block ends it."""

    def __init__(self, order: Mapping[str, Any]) -> None:
        self._order = order
        self._stack = ExitStack()
        self._output = -1

    def __enter__(self) -> _Child:
        self._start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._stack.close()

    def _start(self) -> None:
        """Have it forked; the system ends it when the writing end of the pipe `life` is closed."""
        self._stack.close()
        output, their_output = os.pipe()
        their_life, life = os.pipe()
        for fd in (output, life):
            self._stack.callback(os.close, fd)
        try:
            _nursery.fork(self._order, fds=(their_output, their_life))
        finally:
            os.close(their_output)
            os.close(their_life)
        self._output = output

    def messages(self, budget: Budget, progress: Progress) -> Iterator[tuple[bytes, bytes]]:
        buffer, waited_s, restarted, has_begun = bytearray(), 0.0, False, False
        while True:
            while (message := _taken(buffer)) is not None:
                waited_s, has_begun = waited_s if has_begun else 0.0, True
                yield message
            started = time.monotonic()
            data = self._received()
            waited_s += time.monotonic() - started
            progress.check()
            if data:
                buffer += data
            elif data is not None and not has_begun and not restarted:
                restarted = True  # the process that forks children ended just then
                self._start()
            elif data is not None:
                raise _lost(waited_s, budget)
            if waited_s > budget.wait_s:
                raise _too_slow(waited_s)

    def _received(self) -> bytes | None:
        """Wait a moment; return bytes, none at the end, or None if there were none in time."""
        poll = select.poll()
        poll.register(self._output, select.POLLIN)
        return os.read(self._output, _BLOCK) if poll.poll(_POLL_S * 1000) else None


def _taken(buffer: bytearray) -> tuple[bytes, bytes] | None:
    """Remove the first message from a buffer; None if it is not complete yet."""
    if len(buffer) < HEAD_BYTES:
        return None
    end = HEAD_BYTES + int.from_bytes(buffer[1:HEAD_BYTES], "little")
    if end > HEAD_BYTES + MAX_MESSAGE:
        raise TrackError("the file has an entry that is too large", hint=_HINT)
    if len(buffer) < end:
        return None
    kind, data = bytes(buffer[:1]), bytes(buffer[HEAD_BYTES:end])
    del buffer[:end]
    return kind, data


class _Nursery:
    """The process that forks the children of this process; it ends with it, or when it was idle for long."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._owner = 0

    def fork(self, order: Mapping[str, Any], *, fds: tuple[int, int]) -> None:
        """Have a child forked that gets copies of two file descriptors."""
        data = json.dumps(order).encode()
        with self._lock:
            if self._socket is None or self._owner != os.getpid():
                self._begin()
            try:
                self._send(data, fds)
            except (BrokenPipeError, ConnectionResetError):  # it has ended
                self._begin()
                self._send(data, fds)

    def _send(self, data: bytes, fds: tuple[int, int]) -> None:
        assert self._socket is not None
        socket.send_fds(self._socket, [len(data).to_bytes(4, "little")], list(fds))
        self._socket.sendall(data)

    def close(self) -> None:
        """End the process, once its children have ended."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _begin(self) -> None:
        self.close()
        self._socket, theirs = socket.socketpair()
        self._owner = os.getpid()
        paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
        environment = {**environment_for(), **dict.fromkeys(_NATIVE, "1"), "PYTHONPATH": paths}
        with theirs:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "webapp.files.gate_child"],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the caller, which then ends it
            )
        threading.Thread(target=process.wait, daemon=True).start()  # so that it leaves no zombie
        atexit.unregister(self.close)
        atexit.register(self.close)


_nursery = _Nursery()


def _error(kind: bytes, data: bytes, budget: Budget) -> ExpMapError:
    if kind == MEMORY:
        return TrackError(f"it needs more than {budget.memory_mb:.0f} MB of memory to be read", hint=_HINT)
    if kind == TIME:
        return _too_slow(budget.cpu_s)
    if kind == BUG:
        logging.getLogger(__name__).error("a reader failed:\n%s", data.decode("utf-8", "replace"))
        return _unreadable()
    found = json.loads(data)
    error = next((error for error in _ERRORS if error.__name__ == found["type"]), TrackError)
    return error(found["message"], where=found["where"], hint=found["hint"])


def _lost(waited_s: float, budget: Budget) -> TrackError:
    """Return the error for a child that has died: its time was over, or a library ran out of memory."""
    return _too_slow(budget.cpu_s) if waited_s >= budget.cpu_s else _unreadable()


def _unreadable() -> TrackError:
    return TrackError("it cannot be read: its content is damaged or takes too much memory", hint=_HINT)


def _too_slow(seconds: float) -> TooSlow:
    return TooSlow(f"it takes more than {seconds:.0f} s to be read", hint=_HINT)
