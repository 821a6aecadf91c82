"""Accepts the connections of a server in the supervisor, and queues them for the web processes.

Health checks are answered at once, however busy the web processes are. All other connections are passed to
these: whichever is free first takes the next one. The web processes thus do not hold the listening socket,
and the port is free as soon as the supervisor has ended. A message of the queue is one byte and a file
descriptor (`SCM_RIGHTS`). Messages stay in the queue while no web process runs. Linux only.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import json
import logging
import math
import re
import socket
import struct
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self

from webapp.jobs.health import PROBES, Health, Report
from webapp.settings import Settings
from webapp.store.library import Library

_log = logging.getLogger(__name__)

_PROBE = re.compile(rb"(GET|HEAD) /(%s)[ ?]" % "|".join(PROBES).encode())
_BEGIN_BYTES = 16
_HEAD_BYTES = 8192
_SILENT_S = 1.0
"""Seconds after which a connection without a request is passed on: the web processes have timeouts for it."""

_CONNECTIONS = 800
"""Maximum number of connections that have not been passed on; further ones wait in the listening socket."""

_STUCK_S = 10.0
"""Seconds without an empty queue after which the web processes count as stuck."""

_PAUSE_S = 0.1
_STOPS_WITHIN_S = 2.0


class Acceptor:
    """A thread that accepts connections."""

    def __init__(
        self, listener: socket.socket, library: Library, *, settings: Settings, draining: Callable[[], bool]
    ) -> None:
        self._listener = listener
        self._health = Health(library, settings, draining=draining, takes_requests=self.takes_requests)
        self._patience_s = settings.serve.patience_s
        listener.setblocking(False)
        self._queue, self.receiving_end = connection_queue()
        self._turn = asyncio.Lock()
        self._has_passed_on = False
        self._empty_at = -math.inf
        self._reports: dict[str, asyncio.Task[Report]] = {}
        self._loop = asyncio.new_event_loop()
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="acceptor", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._queue.close()  # web processes that are still running notice it, and end
        self.receiving_end.close()

    def is_running(self) -> bool:
        return self._thread.is_alive()

    def stop(self) -> None:
        """Accept no more connections."""
        with suppress(RuntimeError):  # it has stopped
            self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(_STOPS_WITHIN_S)

    def takes_requests(self) -> bool:
        """Return whether the web processes take connections: their queue was empty not long ago."""
        self._note_empty_queue()
        return time.monotonic() - self._empty_at < _STUCK_S

    def _note_empty_queue(self) -> None:
        if self._has_passed_on and self._queue.is_empty():
            self._empty_at = time.monotonic()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._accept_until_stopped())
        except Exception:  # noqa: BLE001 - the supervisor ends when this thread has ended
            _log.exception("connections are no longer accepted")

    async def _accept_until_stopped(self) -> None:
        accepting = asyncio.create_task(self._accept())
        stopping = asyncio.create_task(self._stopping.wait())
        done, _ = await asyncio.wait([accepting, stopping], return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()

    async def _accept(self) -> None:
        free = asyncio.Semaphore(_CONNECTIONS)
        tasks = set()

        def end(task: asyncio.Task[None]) -> None:
            free.release()
            tasks.discard(task)

        while True:
            await free.acquire()
            try:
                connection, _ = await self._loop.sock_accept(self._listener)
            except OSError as error:
                free.release()
                _log.warning("a connection was not accepted: %s", error)
                await asyncio.sleep(_PAUSE_S)
                continue
            task = asyncio.create_task(self._serve(connection))
            tasks.add(task)
            task.add_done_callback(end)

    async def _serve(self, connection: socket.socket) -> None:
        """Answer a health check, or pass the connection on."""
        with connection:
            try:
                probe = _PROBE.match(await self._first_bytes(connection))
                if probe is None:
                    await self._pass_on(connection)
                else:
                    await self._answer(connection, probe[2].decode())
            except (OSError, EOFError, asyncio.LimitOverrunError) as error:
                _log.debug("a connection ended: %s", error)
            except Exception:  # noqa: BLE001 - the thread must outlive an error with one connection
                _log.exception("a connection could not be handled")

    async def _first_bytes(self, connection: socket.socket) -> bytes:
        """Return how a request begins, without taking it from the connection; nothing if that is silent."""
        loop = self._loop
        if not await _happens(loop.add_reader, loop.remove_reader, connection, within_s=_SILENT_S):
            return b""
        begin = connection.recv(_BEGIN_BYTES, socket.MSG_PEEK)
        if not begin:
            raise EOFError("the client has sent nothing")
        return begin

    async def _pass_on(self, connection: socket.socket) -> None:
        async with self._turn:
            self._note_empty_queue()
            while True:
                try:
                    self._queue.send_connection(connection)
                except BlockingIOError:
                    await _happens(self._loop.add_writer, self._loop.remove_writer, self._queue)
                except TooManyPassed:
                    await asyncio.sleep(_PAUSE_S)
                else:
                    self._has_passed_on = True
                    return

    async def _answer(self, connection: socket.socket, name: str) -> None:
        reader, writer = await asyncio.open_connection(sock=connection, limit=_HEAD_BYTES)
        try:
            async with asyncio.timeout(self._patience_s):
                head = await reader.readuntil(b"\r\n\r\n")
            report, status = await self._report(name)
            writer.write(_response(report, status, with_body=head.startswith(b"GET")))
            async with asyncio.timeout(self._patience_s):
                await writer.drain()
        finally:
            writer.close()
        await writer.wait_closed()

    async def _report(self, name: str) -> Report:
        """Check the health in a thread; checks at the same time share one."""
        running = self._reports.get(name)
        if running is None or running.done():
            running = asyncio.create_task(asyncio.to_thread(PROBES[name], self._health))
            self._reports[name] = running
        return await asyncio.shield(running)


async def _happens(
    add: Callable[..., None],
    remove: Callable[[socket.socket], object],
    end: socket.socket,
    *,
    within_s: float | None = None,
) -> bool:
    """Wait until a socket can be read or written; returns whether it can within the time."""
    happened = asyncio.Event()
    add(end, happened.set)
    try:
        async with asyncio.timeout(within_s):
            await happened.wait()
    except TimeoutError:
        return False
    finally:
        remove(end)
    return True


def _response(report: Mapping[str, str], status: HTTPStatus, *, with_body: bool) -> bytes:
    body = json.dumps(report).encode() + b"\n"
    head = (
        f"HTTP/1.1 {status.value} {status.phrase}\r\n"
        "Content-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n"
        "Cache-Control: no-store\r\n"
        "X-Content-Type-Options: nosniff\r\n"
        "Connection: close\r\n\r\n"
    )
    return head.encode() + (body if with_body else b"")


CAN_PASS = sys.platform == "linux"
"""Whether there are such queues; elsewhere the web processes accept connections themselves."""

_MARK = b"c"


class TooManyPassed(Exception):
    """Too many file descriptors are in queues, for the limits of the system."""


class SendingEnd(socket.socket):
    def send_connection(self, connection: socket.socket) -> None:
        """Send a copy of a connection.

        Raises:
            BlockingIOError: The queue is full.
        """
        try:
            socket.send_fds(self, [_MARK], [connection.fileno()])
        except OSError as error:
            if error.errno == errno.ETOOMANYREFS:
                raise TooManyPassed from error
            raise

    def is_empty(self) -> bool:
        """Return whether everything that was sent has been received."""
        (unread,) = struct.unpack("i", fcntl.ioctl(self, termios.TIOCOUTQ, struct.pack("i", 0)))
        return bool(unread == 0)


class ReceivingEnd(socket.socket):
    """The end of the web processes, which gunicorn takes for a listening socket."""

    def accept(self) -> tuple[socket.socket, Any]:
        """Take a connection; returns it with the client's address.

        Raises:
            BlockingIOError: There is none.
            EOFError: The supervisor is gone.
            ConnectionAbortedError: The client is gone, or this process has no free file descriptor.
        """
        data, fds, _, _ = socket.recv_fds(self, len(_MARK), 1, socket.MSG_CMSG_CLOEXEC)
        if not data:
            raise EOFError("the supervisor is gone")
        if not fds:
            raise ConnectionAbortedError(errno.ECONNABORTED, "no free file descriptor")
        connection = socket.socket(fileno=fds[0])
        try:
            return connection, connection.getpeername()
        except OSError as error:
            connection.close()
            raise ConnectionAbortedError(errno.ECONNABORTED, "the client is gone") from error

    def getsockname(self) -> tuple[str, int]:
        """Return an address that is not a string, as gunicorn would delete a file of that name."""
        return "", 0


def connection_queue() -> tuple[SendingEnd, ReceivingEnd]:
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return SendingEnd(fileno=ends[0].detach()), ReceivingEnd(fileno=ends[1].detach())
