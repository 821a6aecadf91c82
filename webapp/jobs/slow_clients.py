"""Threads of the web server that no slow client can keep: a request has to arrive, and an answer to be taken.

Gunicorn's threads read requests themselves, and would wait without end for one that stops half-way.
"""

from __future__ import annotations

import errno
import socket
import time
from functools import partial
from selectors import EVENT_READ
from typing import Any

from gunicorn import util  # type: ignore[import-untyped]
from gunicorn.workers.gthread import TConn, ThreadWorker  # type: ignore[import-untyped]

LEAST_BYTES_PER_S = 2000
"""Slower than any network that photos are sent over."""

_ANSWER_S = 60.0
_SILENT = 4
"""Times the patience: how long a connection may stay silent, which keeps no thread.

A network that loses packets, or a busy machine, can hold back for a while what a client has sent.
"""

_CROWDED = 0.5
"""Share of the connections of a process from which silent ones are closed after the patience alone."""
_LINGER_S = 0.1
"""How long a connection that is being closed is listened to, by the one thread that accepts all others."""


class ClientSocket(socket.socket):
    """A connection on which a request has to arrive in time.

    All its reads together may wait for `patience_s` seconds, and a second more for each `LEAST_BYTES_PER_S`
    bytes that came; a write may wait for a minute. What takes longer counts as a connection that broke.
    """

    patience_s = 15.0
    _waited_s = 0.0
    _received = 0

    def begin_request(self) -> None:
        """Start counting anew."""
        self._waited_s, self._received = 0.0, 0

    def setblocking(self, flag: bool) -> None:
        """Let reads and writes return at once, or wait for as long as they may."""
        self.settimeout(_ANSWER_S if flag else 0.0)

    def recv(self, size: int, flags: int = 0) -> bytes:
        """Receive some bytes.

        Raises
        ------
        ConnectionResetError
            The request takes too long.
        """
        left_s = self.patience_s + self._received / LEAST_BYTES_PER_S - self._waited_s
        before, start = self.gettimeout(), time.monotonic()
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

        Raises
        ------
        ConnectionResetError
            The client does not take them.
        """
        try:
            super().sendall(data, flags)
        except TimeoutError as error:
            raise _broken() from error

    def sendfile(self, *args: Any, **options: Any) -> int:
        """Send a file, as `sendall` sends bytes."""
        try:
            return super().sendfile(*args, **options)
        except TimeoutError as error:
            raise _broken() from error


class Connection(TConn):  # type: ignore[misc]
    """A connection that is closed without waiting long for the client to notice."""

    patient_until = 0.0
    """When it counts as silent where others need its room, by the monotonic clock."""

    def close(self, graceful: bool = False) -> None:
        """Close it; gracefully, so that the end of the answer is not lost."""
        if graceful:
            util.close_graceful(self.sock, timeout=_LINGER_S)
        else:
            util.close(self.sock)


class PatientWorker(ThreadWorker):  # type: ignore[misc]
    """Gunicorn's worker, with connections that get a thread once a request begins to arrive."""

    def accept(self, listener: socket.socket) -> None:
        """Accept a connection, and wait for its first bytes without a thread."""
        try:
            accepted, address = listener.accept()
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ECONNABORTED, errno.EWOULDBLOCK):
                return  # another process was quicker, or the client has gone
            raise
        self.nr_conns += 1
        connection = Connection(
            self.cfg, ClientSocket(fileno=accepted.detach()), address, listener.getsockname()
        )
        connection.patient_until = time.monotonic() + ClientSocket.patience_s
        connection.timeout = connection.patient_until + (_SILENT - 1) * ClientSocket.patience_s
        self.pending_conns.append(connection)
        self.poller.register(
            connection.sock, EVENT_READ, partial(self.on_pending_socket_readable, connection)
        )

    def murder_pending(self) -> None:
        """Close connections that were silent for long; sooner where many are open or the server stops."""
        if not self.alive or self.nr_conns > _CROWDED * self.worker_connections:
            for connection in self.pending_conns:
                connection.timeout = connection.patient_until
        super().murder_pending()

    def handle(self, conn: Connection) -> Any:
        """Answer a request."""
        conn.sock.begin_request()
        return super().handle(conn)


def _broken() -> ConnectionResetError:
    return ConnectionResetError(errno.ECONNRESET, "the client is too slow")
