"""A server of raw bytes that misbehaves on purpose: it drips, floods, lies about sizes, and never ends."""

import gzip
import itertools
import socket
import ssl
import threading
import time
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

OK = b"HTTP/1.1 200 OK\r\n"
PAUSE_S = 0.01


def _repeated(*head, part, pause_s=0.0):
    yield from head
    while True:
        yield part
        time.sleep(pause_s)


def _bomb():
    """Yield a valid gzip file of 1 GB of zeros."""
    zeros = gzip.compress(bytes(10_000_000))
    yield OK + b"Content-Encoding: gzip\r\nConnection: close\r\n\r\n"
    yield from itertools.repeat(zeros, 100)


WAYS = {
    "head drips": lambda: _repeated(OK, part=b"X", pause_s=PAUSE_S),
    "body drips": lambda: _repeated(OK + b"Content-Length: 900\r\n\r\n", part=b"[", pause_s=PAUSE_S),
    "body drips without a length": lambda: _repeated(OK + b"\r\n", part=b"[", pause_s=PAUSE_S),
    "chunks drip": lambda: _repeated(
        OK + b"Transfer-Encoding: chunked\r\n\r\n", part=b"1\r\n[\r\n", pause_s=PAUSE_S
    ),
    "body without end": lambda: _repeated(OK + b"\r\n", part=b"[" * 60_000),
    "size of a chunk without end": lambda: _repeated(
        OK + b"Transfer-Encoding: chunked\r\n\r\n1;", part=b"x" * 60_000
    ),
    "trailer without end": lambda: _repeated(
        OK + b"Transfer-Encoding: chunked\r\n\r\n1\r\n[\r\n0\r\n", part=b"A: %s\r\n" % (b"b" * 60_000)
    ),
    "continue without end": lambda: _repeated(part=b"HTTP/1.1 100 Continue\r\n\r\n" * 1000),
    "headers without end": lambda: _repeated(OK, part=b"X: y\r\n" * 1000),
    "a header without end": lambda: _repeated(OK + b"X: ", part=b"x" * 60_000),
    "less than announced": lambda: [OK + b"Content-Length: 900\r\n\r\n["],
    "a negative length": lambda: [OK + b"Content-Length: -5\r\n\r\n["],
    "two lengths": lambda: [OK + b"Content-Length: 1\r\nContent-Length: 9000\r\n\r\n["],
    "gzip of a gigabyte": _bomb,
    "many codings": lambda: [
        OK + b"Content-Encoding: " + b"gzip, " * 500 + b"gzip\r\nContent-Length: 1\r\n\r\n["
    ],
    "not gzip": lambda: [OK + b"Content-Encoding: gzip\r\nContent-Length: 4\r\n\r\n[][]"],
    "not HTTP": lambda: [b"220 ready\r\n" * 10],
    "nothing": list,
}
"""Answers by name: parts to send, after which the connection is closed."""


class HostileServer:
    """Answers every request in the chosen way; `asked` counts requests, `sent` bytes."""

    def __init__(self):
        self.answer = WAYS["nothing"]
        self.asked, self.sent = 0, 0
        self.port = None
        self.finished = threading.Event()

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}"

    def serve(self, connection):
        with connection:
            try:
                if not connection.recv(65_536):
                    return
                self.asked += 1
                for part in self.answer():
                    connection.sendall(part)
                    self.sent += len(part)
                    if self.finished.is_set():
                        return
            except OSError:
                return  # the client has had enough


@contextmanager
def hostile():
    """Run a server during the block."""
    server = HostileServer()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server.port = listening.getsockname()[1]

        def listen():
            while True:
                try:
                    connection, _ = listening.accept()
                except OSError:
                    return
                threading.Thread(target=server.serve, args=(connection,), daemon=True).start()

        thread = threading.Thread(target=listen, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.finished.set()
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()


@contextmanager
def pretending(name, folder):
    """Run a TLS server with a certificate that it signed itself; give its port and its requests."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(_signed_by_itself(name, folder))
    requests = []
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def listen():
            while True:
                try:
                    connection, _ = listening.accept()
                    with context.wrap_socket(connection, server_side=True) as secure:
                        requests.append(secure.recv(65_536))
                except ssl.SSLError:
                    continue
                except OSError:
                    return

        thread = threading.Thread(target=listen, daemon=True)
        thread.start()
        try:
            yield listening.getsockname()[1], requests
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()


def _signed_by_itself(name, folder):
    """Write a key and a certificate to one file; return its path."""
    key = ec.generate_private_key(ec.SECP256R1())
    who = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder(who, who, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .sign(key, hashes.SHA256())
    )
    path = folder / "server.pem"
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    path.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, *form)
        + certificate.public_bytes(serialization.Encoding.PEM)
    )
    return path
