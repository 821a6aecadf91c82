"""Forks children that parse files of strangers, each with limits, for `webapp.files.gate`.

    python -m webapp.files.gate_child

Standard input is a socket over which the parent sends orders, each with two file descriptors: the pipe for
the child's messages, and one whose other end the parent keeps open for as long as the child may live.
"""

from __future__ import annotations

import fcntl
import gc
import importlib
import json
import os
import pathlib
import resource
import select
import signal
import socket
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NoReturn

from webapp.errors import ExpMapError
from webapp.files.gate import BUG, DATA, END, ERROR, HEAD_BYTES, MEMORY, STARTED, TIME
from webapp.importing import import_name

_IDLE_S = 120.0
_NICE = 5
"""Answering requests goes before reading files."""

_GRACE_S = 1
"""CPU seconds after which a child is killed that does not end by itself when its time is over."""

_RESERVE = 8 << 20
"""Bytes that are freed when memory is exhausted, to report it."""

_MAX_FDS = 2


class _OutOfTime(BaseException):
    """The CPU time is over; not an `Exception`, as readers take those for signs of damage."""


def main() -> None:
    """Fork a child for each order until the parent is gone, or there was none for a while."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # children leave no zombies
    with socket.socket(fileno=os.dup(0)) as parent:
        wait = select.poll()
        wait.register(parent, select.POLLIN)
        while wait.poll(_IDLE_S * 1000):
            head, fds, _flags, _address = socket.recv_fds(parent, 4, _MAX_FDS)
            if not head:
                return
            while len(head) < 4:
                head += parent.recv(4 - len(head)) or b"\0" * 4
            data = _received(parent, int.from_bytes(head[:4], "little"))
            if data is None:
                return
            order = json.loads(data)
            _preload(order)
            if os.fork() == 0:
                os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # the socket is only for its parent
                parent.close()
                _be_child(order, output=fds[0], life=fds[1])
            for fd in fds:
                os.close(fd)


def _received(parent: socket.socket, size: int) -> bytes | None:
    data = bytearray()
    while len(data) < size:
        part = parent.recv(size - len(data))
        if not part:
            return None
        data += part
    return bytes(data)


def _preload(order: Mapping[str, Any]) -> None:
    """Import the reader before the fork; what fails here fails again in the child, which reports it."""
    for name in (*order["preload"], order["target"].partition(":")[0]):
        if name not in sys.modules:
            with suppress(ImportError):
                importlib.import_module(name)
            gc.freeze()


def _be_child(order: Mapping[str, Any], *, output: int, life: int) -> NoReturn:
    try:
        _end_with_parent(life)
        _send(output, STARTED)
        _limit(order)
        _send(output, *_outcome(order, output))
    except BrokenPipeError:
        pass  # the parent no longer listens
    finally:
        os._exit(0)


def _outcome(order: Mapping[str, Any], output: int) -> tuple[bytes, bytes]:
    """Send the messages of the reader; return the last one."""
    reserve = [bytearray(_RESERVE)]
    try:
        for data in import_name(order["target"])(**order["arguments"]):
            _send(output, DATA, data)
        return END, b""
    except BrokenPipeError:
        raise
    except _OutOfTime:
        return TIME, b""
    except MemoryError:
        reserve.clear()
        return MEMORY, b""
    except ExpMapError as error:
        found = {"type": type(error).__name__, "message": error.message, "where": error.where}
        return ERROR, json.dumps({**found, "hint": error.hint}).encode()
    except Exception:  # noqa: BLE001 - the parent logs it
        return BUG, traceback.format_exc()[-10_000:].encode("utf-8", "replace")


def _end_with_parent(life: int) -> None:
    """Have the system kill this process, whatever it is doing, once the other end of the pipe is closed."""
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(life, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(life, fcntl.F_SETFL, fcntl.fcntl(life, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([life], [], [], 0)[0]:
        os._exit(0)  # it was closed before


def _limit(order: Mapping[str, Any]) -> None:
    """Limit memory, CPU time and files of this process; there is no way back."""
    os.nice(_NICE)
    signal.signal(signal.SIGXCPU, _stop)
    used_s = sum(os.times()[:2])
    cpu_s = int(used_s) + order["cpu_s"]
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + _GRACE_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if order["write_bytes"] is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (order["write_bytes"],) * 2)
    with suppress(OSError):  # only Linux has this file; macOS does not enforce the limit either
        with pathlib.Path("/proc/self/statm").open(encoding="ascii") as file:
            size = int(file.read().split()[0]) * resource.getpagesize()
        most = size + order["memory_bytes"] + _RESERVE
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _stop(_signal: int, _frame: object) -> None:
    raise _OutOfTime


def _send(output: int, kind: bytes, data: bytes = b"") -> None:
    message = memoryview(kind + len(data).to_bytes(HEAD_BYTES - 1, "little") + data)
    while message:
        message = message[os.write(output, message) :]


if __name__ == "__main__":
    main()
