"""A queue of accepted connections from the supervisor to its web processes, which share its receiving end.

A message is one byte and a file descriptor (`SCM_RIGHTS`). Messages stay in the queue while no web process
runs. Linux only.
"""

from __future__ import annotations

import errno
import fcntl
import socket
import struct
import sys
import termios
from typing import Any

CAN_PASS = sys.platform == "linux"
"""Whether there are such queues; elsewhere the web processes accept connections themselves."""

_MARK = b"c"


class TooManyPassed(Exception):
    """Too many file descriptors are in queues, for the limits of the system."""


class SendingEnd(socket.socket):
    """The end of the supervisor."""

    def send_connection(self, connection: socket.socket) -> None:
        """Send a copy of a connection.

        Raises:
            BlockingIOError: The queue is full.
            TooManyPassed
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
    """Make a queue, whose ends do not block."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return SendingEnd(fileno=ends[0].detach()), ReceivingEnd(fileno=ends[1].detach())
