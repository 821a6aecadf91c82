"""A proxy in front of a server that can be cut, like a network."""

import os
import selectors
import socket
import threading
from contextlib import suppress

_BLOCK = 1 << 16


class TcpProxy:
    """Listens on a port of 127.0.0.1 and forwards everything to a Unix socket.

    Attributes
    ----------
    address : tuple of str and int
        Address to listen on.
    cut_before_answer_to : bytes or None
        When a client sends this, it is forwarded, and the client is cut off before the response.
    """

    def __init__(self, server: str | os.PathLike[str]) -> None:
        self._server = os.fspath(server)
        self._lock = threading.Lock()
        self._pairs: set[tuple[socket.socket, socket.socket]] = set()
        self._is_cut = False
        self.cut_before_answer_to: bytes | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address: tuple[str, int] = self._listener.getsockname()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Close all connections, and refuse new ones."""
        with self._lock:
            self._is_cut = True
            for pair in self._pairs:
                _end(pair)

    def mend(self) -> None:
        """Accept connections again."""
        with self._lock:
            self._is_cut = False

    def close(self) -> None:
        """Stop the proxy."""
        self.cut()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with self._lock:
                if self._is_cut:
                    client.close()
                    continue
                server = socket.socket(socket.AF_UNIX)
                try:
                    server.connect(self._server)
                except OSError:
                    client.close()
                    server.close()
                    continue
                pair = (client, server)
                self._pairs.add(pair)
            threading.Thread(target=self._pass_on, args=(pair,), daemon=True).start()

    def _pass_on(self, pair: tuple[socket.socket, socket.socket]) -> None:
        client, server = pair
        with selectors.DefaultSelector() as ready:
            ready.register(client, selectors.EVENT_READ, server)
            ready.register(server, selectors.EVENT_READ, client)
            with suppress(OSError):
                while all(self._step(key.fileobj, key.data, client) for key, _ in ready.select()):
                    pass
        with self._lock:
            self._pairs.discard(pair)
            _end(pair)
            client.close()
            server.close()

    def _step(self, source: socket.socket, target: socket.socket, client: socket.socket) -> bool:
        data = source.recv(_BLOCK)
        target.sendall(data)
        wanted = self.cut_before_answer_to
        if source is client and wanted is not None and wanted in data:
            self.cut_before_answer_to = None
            target.recv(_BLOCK)  # the server has responded, so it is done
            return False
        return bool(data)


def _end(pair: tuple[socket.socket, socket.socket]) -> None:
    for one in pair:
        with suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)
