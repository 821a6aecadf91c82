"""A network that can be cut: connections break, new ones are refused."""

import contextlib
import socket
import threading


class Wire:
    """A proxy between clients that connect to `url` and a server.

    Parameters
    ----------
    server : tuple of str and int
        Its address.
    """

    def __init__(self, server: tuple[str, int]) -> None:
        self._server = server
        self._open: set[socket.socket] = set()
        self._guard = threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._is_cut = False
        self.cuts = 0
        self.passed = 0
        """Number of blocks that were passed on."""

    @property
    def url(self) -> str:
        """Return the address for clients."""
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> "Wire":
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cut()
        self._listener.close()
        self.cuts -= 1

    def cut(self) -> None:
        """Break all connections, and refuse new ones."""
        with self._guard:
            self._is_cut = True
            self.cuts += 1
            for sock in self._open:
                with contextlib.suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)
                sock.close()
            self._open.clear()

    def mend(self) -> None:
        """Pass data on again."""
        with self._guard:
            self._is_cut = False

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
                server = None if self._is_cut else socket.create_connection(self._server, 2)
            except ConnectionError:
                client.close()
                continue
            except OSError:
                return  # the listener was closed
            if server is not None:
                server.settimeout(None)  # only for connecting
            with self._guard:
                if server is None or self._is_cut:
                    client.close()
                    if server is not None:
                        server.close()
                    continue
                self._open |= {client, server}
            for here, there in ((client, server), (server, client)):
                threading.Thread(target=self._pass_on, args=(here, there), daemon=True).start()

    def _pass_on(self, here: socket.socket, there: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := here.recv(65536):
                there.sendall(data)
                self.passed += 1
        for sock in (here, there):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
