"""Where the packets come from: datagrams, a TCP connection, or a serial port."""

from __future__ import annotations

import io
import os
import re
import select
import socket
from abc import ABC, abstractmethod
from typing import Any, Self

from webapp.errors import InputError, UsageError

_TIMEOUT_S = 15.0
_MOST_BYTES = 1 << 16
_SOURCE = re.compile(r"(udp|tcp|serial):(?://)?(.+):(\d{1,7})")
_HINT = "write udp:0.0.0.0:14550, tcp:HOST:5760 or serial:/dev/ttyACM0:57600"


class Link(ABC):
    """An open source of packets."""

    is_whole = False
    """Whether what is read at once ends with a packet."""

    def __init__(self, source: str) -> None:
        self._source = source

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def read(self, wait_s: float) -> bytes:
        """Return what has arrived, empty if nothing has; raises InputError if the connection is lost."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send a packet to the vehicle that was read last; raises InputError as `read` does."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    def failure(self, error: OSError) -> InputError:
        """Return the error that says why it failed."""
        return InputError(
            f"cannot receive: {error.strerror or error or 'no answer'}",
            where=self._source,
            hint="is the vehicle connected, and does no other program use the port?",
        )


def open_link(source: str) -> Link:
    """Open a source.

    Args:
        source: `udp:ADDRESS:PORT` to listen on, `tcp:HOST:PORT` to connect to, or `serial:DEVICE:BAUD`.

    Raises:
        UsageError: This is not a source.
        InputError: It cannot be opened.
    """
    found = _SOURCE.fullmatch(source)
    if found is None:
        raise UsageError("this is not a source of MAVLink", where=source[:100], hint=_HINT)
    kind, place, number = found[1], found[2], int(found[3])
    if kind == "serial":
        return _SerialLink(source, place, baud=number)
    if not 0 < number < 65_536:
        raise UsageError("the port is not a number from 1 to 65535", where=source[:100], hint=_HINT)
    host = place.strip("[]")
    return (
        _DatagramLink(source, host, port=number) if kind == "udp" else _StreamLink(source, host, port=number)
    )


class _DatagramLink(Link):
    """Datagrams sent to this computer."""

    is_whole = True

    def __init__(self, source: str, host: str, *, port: int) -> None:
        super().__init__(source)
        self._sender: Any = None
        try:
            family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind)
        except OSError as error:
            raise self.failure(error) from error
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise self.failure(error) from error

    def read(self, wait_s: float) -> bytes:
        self._socket.settimeout(wait_s)
        try:
            data, self._sender = self._socket.recvfrom(_MOST_BYTES)
        except (TimeoutError, ConnectionError):  # Windows reports that a receiver of ours is gone
            return b""
        except OSError as error:
            raise self.failure(error) from error
        return data

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, self._sender)
        except OSError as error:
            raise self.failure(error) from error

    def close(self) -> None:
        self._socket.close()


class _StreamLink(Link):
    """A connection to a vehicle, a simulator or a router."""

    def __init__(self, source: str, host: str, *, port: int) -> None:
        super().__init__(source)
        try:
            self._socket = socket.create_connection((host, port), timeout=_TIMEOUT_S)
        except OSError as error:
            raise self.failure(error) from error

    def read(self, wait_s: float) -> bytes:
        self._socket.settimeout(wait_s)
        try:
            data = self._socket.recv(_MOST_BYTES)
        except TimeoutError:
            return b""
        except OSError as error:
            raise self.failure(error) from error
        if not data:
            raise InputError("the connection was closed", where=self._source)
        return data

    def write(self, data: bytes) -> None:
        self._socket.settimeout(_TIMEOUT_S)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise self.failure(error) from error

    def close(self) -> None:
        self._socket.close()


class _SerialLink(Link):
    """A serial port or USB, on Linux and macOS."""

    def __init__(self, source: str, device: str, *, baud: int) -> None:
        super().__init__(source)
        try:
            import termios
            import tty
        except ImportError as error:
            hint = "have a ground station forward the packets, and use udp:0.0.0.0:14550"
            raise UsageError("serial ports cannot be read on this system", where=source, hint=hint) from error
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise UsageError(f"{baud} is not a baud rate of this system", where=source, hint="such as 57600")
        try:
            self._port = io.FileIO(os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), "r+")
        except OSError as error:
            raise self.failure(error) from error
        try:
            tty.setraw(self._port.fileno())
            settings = termios.tcgetattr(self._port)
            settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
            settings[4] = settings[5] = speed
            termios.tcsetattr(self._port, termios.TCSANOW, settings)
        except termios.error as error:
            self._port.close()
            raise InputError("this is not a serial port", where=source, hint=_HINT) from error

    def read(self, wait_s: float) -> bytes:
        try:
            is_ready = bool(select.select([self._port], [], [], wait_s)[0])
            data = self._port.read(_MOST_BYTES) if is_ready else None
        except OSError as error:
            raise self.failure(error) from error
        if data == b"":
            raise InputError("the device was removed", where=self._source)
        return data or b""

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)  # None if there is no room: the caller asks again
        except OSError as error:
            raise self.failure(error) from error

    def close(self) -> None:
        self._port.close()
