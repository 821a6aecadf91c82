"""Detects clients that have left before their request was answered."""

from __future__ import annotations

import select
import socket

from flask import request

from webapp.progress import Progress


class ClientProgress(Progress):
    """Progress of a request, which counts as cancelled once its client has closed the connection.

    Behind a proxy the connection is the proxy's, which closes it for a client that has left.
    """

    def __init__(self) -> None:
        self._socket: socket.socket | None = request.environ.get("gunicorn.socket")

    def cancelled(self) -> bool:
        """Return whether the connection is closed; False on other servers than ours, and in tests."""
        if self._socket is None:
            return False
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        if not poll.poll(0):
            return False
        try:
            # nothing can be read at the end of a connection; the beginning of a next request stays there
            return not socket.socket.recv(self._socket, 1, socket.MSG_PEEK)
        except OSError:
            return True  # it was reset
