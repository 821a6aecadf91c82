"""Sends events to a TAK server by TCP or TLS, or to a multicast group or host by UDP."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

from webapp.connect.tak.events import MESH_HEADER, CotEvent, to_protobuf, to_stream, to_xml
from webapp.errors import InputError, UsageError

_PORTS = {"tcp": 8087, "tls": 8089, "udp": 6969}
_TIMEOUT_S = 15.0
_WHAT = "the address of a TAK server"
_SENDING = "cannot send"


class TakLink:
    """An open connection.

    Args:
        address: `tcp://HOST:PORT`, `tls://HOST:PORT` or `udp://HOST:PORT`; the port may be left out.
        protobuf: Send version 1 of the TAK protocol instead of XML.
        certificate: PEM file with the client's certificate and its key, for TLS.
        authority: PEM file with the certificate that the server's is signed by; None: those of the system.
        interface: Address of the interface that multicast leaves by; None: chosen by the system.

    Raises:
        UsageError: The address or the options cannot work.
        InputError: The server does not answer, or one side refuses the other's certificate.
    """

    def __init__(
        self,
        address: str,
        *,
        protobuf: bool = False,
        certificate: Path | None = None,
        authority: Path | None = None,
        interface: str | None = None,
    ) -> None:
        self._scheme, host, port = parsed(address, secured=bool(certificate or authority))
        self._address, self._protobuf = address, protobuf
        try:
            if self._scheme == "udp":
                self._socket = _datagrams(host, port, interface)
            else:
                self._socket = open_stream(
                    host, port, secured=self._scheme == "tls", certificate=certificate, authority=authority
                )
        except OSError as error:
            raise failure(error, what=_SENDING, address=address) from error

    def __enter__(self) -> Self:
        """Return the link itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection."""
        self._socket.close()

    def send(self, events: Iterable[CotEvent]) -> int:
        """Send events and return their number; raises InputError if the connection is lost."""
        count = 0
        for event in events:
            if not self._protobuf:
                data = to_xml(event)
            elif self._scheme == "udp":
                data = MESH_HEADER + to_protobuf(event)
            else:
                data = to_stream(event)
            try:
                self._socket.sendall(data)
            except OSError as error:
                raise failure(error, what=_SENDING, address=self._address) from error
            count += 1
        return count


def failure(error: OSError, *, what: str, address: str) -> InputError:
    """Return the error that says why a connection failed."""
    if isinstance(error, ssl.SSLError):
        return InputError(
            f"TLS failed: {error.reason or error}",
            where=address,
            hint="check --certificate, with its key, and --authority, which signed the server's",
        )
    reason = error.strerror or str(error) or "no answer"
    return InputError(f"{what}: {reason}", where=address, hint="is the TAK server running?")


def parsed(address: str, *, secured: bool) -> tuple[str, str, int]:
    """Split an address into scheme, host and port.

    Args:
        secured: Whether certificates were given.

    Raises:
        UsageError: The address is invalid, or the certificates do not fit it.
    """
    try:
        parts = urlsplit(address)
        scheme, host, port = parts.scheme, parts.hostname, parts.port
    except ValueError:
        scheme, host, port = "", None, None
    if scheme not in _PORTS or not host:
        raise UsageError(f"this is not {_WHAT}", where=address, hint="such as tls://tak.example.org:8089")
    if secured and scheme != "tls":
        raise UsageError("certificates need TLS", where=address, hint="use tls://HOST:8089")
    return scheme, host, port or _PORTS[scheme]


def open_stream(
    host: str, port: int, *, secured: bool, certificate: Path | None, authority: Path | None
) -> socket.socket:
    """Connect by TCP or TLS; raises OSError."""
    plain = socket.create_connection((host, port), timeout=_TIMEOUT_S)
    return _secured(plain, host, certificate=certificate, authority=authority) if secured else plain


def datagram_address(host: str, port: int) -> tuple[int, int, int, str, tuple[Any, ...]]:
    """Return what `socket.getaddrinfo` finds first for datagrams; raises OSError."""
    return socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]


def _datagrams(host: str, port: int, interface: str | None) -> socket.socket:
    family, kind, _, _, found = datagram_address(host, port)
    made = socket.socket(family, kind)
    try:
        if interface is not None and ipaddress.ip_address(found[0]).version == 4:
            made.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))
        made.connect(found)
    except OSError:
        made.close()
        raise
    return made


def _secured(
    plain: socket.socket, host: str, *, certificate: Path | None, authority: Path | None
) -> ssl.SSLSocket:
    try:
        context = ssl.create_default_context(cafile=authority)
        if certificate is not None:
            context.load_cert_chain(certificate)
        return context.wrap_socket(plain, server_hostname=host)
    except OSError:
        plain.close()
        raise
