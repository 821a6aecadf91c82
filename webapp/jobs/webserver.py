"""The web server: gunicorn, configured here and by no configuration file of its own.

The supervisor starts it as `python -m webapp.jobs.webserver` with the name of the application: gunicorn's
master must not import the application, because a process that has loaded OpenCV or faiss cannot be forked
safely. Gunicorn's threads read requests themselves, and would wait forever for one that stops half-way:
timeouts and threads of their own keep slow requests from blocking the others.
"""

from __future__ import annotations

import argparse
import errno
import mmap
import os
import re
import socket
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from selectors import EVENT_READ
from types import FrameType
from typing import Any

from gunicorn import util  # type: ignore[import-untyped]
from gunicorn.app.base import BaseApplication  # type: ignore[import-untyped]
from gunicorn.arbiter import Arbiter  # type: ignore[import-untyped]
from gunicorn.glogging import Logger  # type: ignore[import-untyped]
from gunicorn.workers.gthread import TConn, ThreadWorker  # type: ignore[import-untyped]

from webapp import telemetry
from webapp.configuration import load_settings
from webapp.importing import import_name
from webapp.jobs.acceptor import ReceivingEnd
from webapp.logs import FORMS, log_to_stderr
from webapp.settings import Settings, restrain_threads
from webapp.threads import cores

LEAST_BYTES_PER_S = 2000
"""Slower than any network that photos are sent over."""

_ANSWER_S = 60.0
_SILENT = 4
"""How long a connection may stay silent, in multiples of the patience; it occupies no thread meanwhile.

Packet loss or a busy machine can delay for a while what a client has sent.
"""

_KEEP_ALIVE_S = 75
"""For the next request on a connection: longer than clients and proxies pause, so that these close first."""

_CROWDED = 0.5
"""Fraction of a process's connections above which silent ones are closed after the plain patience."""

_LINGER_S = 0.5
"""How long a closing connection is still read, so that the end of the response is not lost."""

_LOCALIZE = re.compile(rb"POST /\S*/(localize|find)[ ?]")
_BEGIN_BYTES = 400


class ClientSocket(socket.socket):
    """A connection on which a request has to arrive in time.

    All reads of a request together may wait for `patience_s` seconds, plus one for each `LEAST_BYTES_PER_S`
    bytes received, and no read longer than a shorter timeout of the socket; a write may wait for a minute.
    Slower connections count as broken.
    """

    patience_s = 15.0
    _waited_s = 0.0
    _received = 0

    def begin_request(self) -> None:
        self._waited_s, self._received = 0.0, 0

    def setblocking(self, flag: bool) -> None:
        """Make reads and writes non-blocking, or blocking with a timeout."""
        self.settimeout(_ANSWER_S if flag else 0.0)

    def recv(self, size: int, flags: int = 0) -> bytes:
        """Receive some bytes.

        Raises:
            ConnectionResetError: The request takes too long.
        """
        left_s = self.patience_s + self._received / LEAST_BYTES_PER_S - self._waited_s
        before, start = self.gettimeout(), time.monotonic()
        if before is not None and 0.0 < before < _ANSWER_S:
            left_s = min(left_s, before)
        self.settimeout(max(left_s, 0.001))
        try:
            data = super().recv(size, flags)
        except TimeoutError as error:
            raise _broken() from error
        finally:
            self.settimeout(before)
            self._waited_s += time.monotonic() - start
        self._received += len(data)
        return data

    def sendall(self, data: Any, flags: int = 0) -> None:
        """Send bytes.

        Raises:
            ConnectionResetError: The client does not receive them in time.
        """
        try:
            super().sendall(data, flags)
        except TimeoutError as error:
            raise _broken() from error

    def sendfile(self, *args: Any, **options: Any) -> int:
        """Send a file; errors as `sendall`."""
        try:
            return super().sendfile(*args, **options)
        except TimeoutError as error:
            raise _broken() from error


class Connection(TConn):  # type: ignore[misc]
    """A connection whose client is waited for in the request's thread, never in the one that serves all."""

    patient_until = 0.0
    """Monotonic time from which it counts as silent when many connections are open."""

    def set_timeout(self) -> None:
        """Begin to wait for the next request."""
        super().set_timeout()
        self.patient_until = time.monotonic() + ClientSocket.patience_s

    def peek(self) -> bytes:
        """Return the first unread bytes; none if there are none yet, or the client has gone. Never waits."""
        # What was received behind the rest of a request's body, if there is any, is the next request.
        if received := b"" if self.parser is None else self.parser.unreader.buf.getvalue():
            return bytes(received)
        timeout = self.sock.gettimeout()
        self.sock.settimeout(0.0)  # with a timeout Python would wait, whatever the flags say
        try:
            return socket.socket.recv(self.sock, _BEGIN_BYTES, socket.MSG_PEEK)
        except OSError:
            return b""
        finally:
            self.sock.settimeout(timeout)

    def asks_to_localize(self) -> bool:
        """Return whether a request begins that may wait for its turn to localize; False if not known yet."""
        return _LOCALIZE.match(self.peek()) is not None

    def linger(self) -> None:
        """Close it once the client has closed it, too."""
        util.close_graceful(self.sock, timeout=_LINGER_S)

    def close(self, graceful: bool = False) -> None:
        """Close it at once: after a response, `linger` has waited already."""
        util.close(self.sock)


class PatientWorker(ThreadWorker):  # type: ignore[misc]
    """Gunicorn's threaded worker, whose connections get a thread only once a request begins to arrive."""

    def accept(self, listener: socket.socket) -> None:
        """Accept a connection, and poll for its first bytes without occupying a thread."""
        try:
            accepted, address = listener.accept()
        except EOFError as error:
            self.log.warning("%s: exiting", error)
            os._exit(0)  # at once: the interpreter would wait for all threads
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ECONNABORTED, errno.EWOULDBLOCK):
                return  # another process was quicker, or the client has gone
            raise
        self.nr_conns += 1
        here = accepted.getsockname()
        connection = Connection(self.cfg, ClientSocket(fileno=accepted.detach()), address, here)
        connection.patient_until = time.monotonic() + ClientSocket.patience_s
        connection.timeout = connection.patient_until + (_SILENT - 1) * ClientSocket.patience_s
        self.pending_conns.append(connection)
        self.poller.register(
            connection.sock, EVENT_READ, partial(self.on_pending_socket_readable, connection)
        )

    def murder_pending(self) -> None:
        """Close connections that have been silent too long; earlier if many are open or the server stops."""
        if not self.alive or self._is_crowded():
            for connection in self.pending_conns:
                connection.timeout = connection.patient_until
        super().murder_pending()

    def murder_keepalived(self, force: bool = False) -> None:
        """Close connections without a further request; earlier if many are open.

        A request that has arrived since the last poll is answered: closing its connection would reset it.
        """
        if self._is_crowded():
            for connection in self.keepalived_conns:
                connection.timeout = min(connection.timeout, connection.patient_until)
        now = time.monotonic()
        expired = takewhile(lambda connection: connection.timeout <= now, list(self.keepalived_conns))
        for connection in expired:
            if not force and connection.peek():
                self.on_client_socket_readable(connection, connection.sock)
        super().murder_keepalived(force)

    def _is_crowded(self) -> bool:
        return bool(self.nr_conns > _CROWDED * self.worker_connections)

    def get_thread_pool(self) -> ThreadPoolExecutor:
        """Make the threads; as many more for requests that localize, which others then need not wait for."""
        self.localizing = ThreadPoolExecutor(self.cfg.threads, thread_name_prefix="localizing")
        return ThreadPoolExecutor(self.cfg.threads, thread_name_prefix="request")

    def enqueue_req(self, conn: Connection) -> None:
        """Hand a connection with a request to a thread."""
        pool = self.localizing if conn.asks_to_localize() else self.tpool
        answered = pool.submit(self.handle, conn)
        answered.add_done_callback(partial(self.method_queue.defer, self.finish_request, conn))

    def handle_quit(self, _signal: int, _frame: FrameType | None) -> None:
        """Exit at once: the interpreter would wait for all threads."""
        os._exit(0)

    def handle(self, conn: Connection) -> Any:
        conn.sock.begin_request()
        kept = super().handle(conn)
        if not kept:
            conn.linger()
        return kept


def _broken() -> ConnectionResetError:
    return ConnectionResetError(errno.ECONNRESET, "the client is too slow")


_CONNECTIONS = 800
"""Maximum number of open connections per process; an idle one costs only a file descriptor."""


class Server(BaseApplication):  # type: ignore[misc]
    """Gunicorn for one application.

    Args:
        app: "module:function", called with the settings in each worker process.
        parent: Id of the supervisor's process; the server stops when it is gone.
        listeners: Listening sockets; none: those of the options.
    """

    def __init__(
        self,
        app: str,
        *,
        settings: Settings,
        options: dict[str, Any],
        parent: int,
        listeners: Sequence[socket.socket] = (),
    ) -> None:
        self._app = app
        self._listeners = list(listeners)
        self._loaded = mmap.mmap(-1, 1)  # shared with the worker processes
        self._settings = settings
        self._options = options
        self._parent = parent
        super().__init__()

    def load_config(self) -> None:
        """Set gunicorn's options; it reads no others."""
        for name, value in self._options.items():
            self.cfg.set(name, value)

    def load(self) -> Any:
        """Make the application in a worker process, which limits its native threads to its share of cores."""
        import cv2  # not before the fork

        ClientSocket.patience_s = self._settings.serve.patience_s

        cv2.setNumThreads(native_threads(self.cfg.workers))
        telemetry.start(self._settings.traces)  # its threads would not survive the fork
        create: Callable[[Settings], Any] = import_name(self._app)
        made = create(self._settings)
        self._loaded[0] = 1
        return made

    def is_loaded(self) -> bool:
        """Return whether a worker process has made the application."""
        return self._loaded[0] == 1

    def run(self) -> None:
        """Serve until stopped."""
        master = _Master(self, self._parent)
        master.LISTENERS = self._listeners
        master.run()


class _Master(Arbiter):  # type: ignore[misc]
    """Stops when its parent is gone, and lets the first worker start alone, so that it answers sooner."""

    def __init__(self, app: Server, parent: int) -> None:
        self._parent = parent
        super().__init__(app)
        self.num_workers = 1

    def manage_workers(self) -> None:
        """Start workers; gunicorn calls it every second."""
        if self.num_workers == 1 and self.app.is_loaded():
            self.num_workers = self.cfg.workers
        super().manage_workers()

    def murder_workers(self) -> None:
        """Check the parent and the workers; gunicorn calls it every second."""
        if os.getppid() != self._parent:
            self.log.warning("the supervisor is gone: stopping")
            self.handle_quit()
        super().murder_workers()


class Log(Logger):  # type: ignore[misc]
    """Routes gunicorn's messages to the program's log."""

    def setup(self, cfg: Any) -> None:
        """Remove gunicorn's own handlers."""
        super().setup(cfg)
        self.error_log.handlers.clear()
        self.error_log.propagate = True


def native_threads(workers: int) -> int:
    """Return how many threads the native libraries of each worker process may start."""
    return max(cores() // workers, 1)


def gunicorn_options(settings: Settings, *, fd: int, workers: int) -> dict[str, Any]:
    """Choose gunicorn's options.

    Args:
        fd: File descriptor of the listening socket: requests wait there while gunicorn restarts.
    """
    return {
        "bind": f"fd://{fd}",
        "workers": workers,
        "worker_class": PatientWorker,
        "threads": settings.serve.threads,
        "graceful_timeout": round(settings.serve.stop_s),
        "timeout": 60,
        "keepalive": _KEEP_ALIVE_S,
        "worker_connections": _CONNECTIONS,
        "preload_app": False,
        "control_socket_disable": True,  # it would be in the home folder
        "proc_name": "expmap",
        "loglevel": "warning",
        "logger_class": Log,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve, with the arguments that the supervisor passes."""
    restrain_threads()
    parser = argparse.ArgumentParser()
    parser.add_argument("app")
    parser.add_argument("--library", type=Path, required=True)
    for name in ("--fd", "--workers", "--parent"):
        parser.add_argument(name, type=int, required=True)
    parser.add_argument("--passed", action="store_true", help="--fd is the end of a queue of connections")
    parser.add_argument("--log", choices=FORMS, default="text")
    asked = parser.parse_args(arguments)
    log_to_stderr(asked.log)
    settings = replace(load_settings(), library=asked.library)
    options = gunicorn_options(settings, fd=asked.fd, workers=asked.workers)
    listeners = [ReceivingEnd(fileno=asked.fd)] if asked.passed else []
    Server(asked.app, settings=settings, options=options, parent=asked.parent, listeners=listeners).run()


if __name__ == "__main__":
    main()
