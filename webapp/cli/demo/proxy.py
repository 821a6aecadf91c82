"""A small reverse proxy for `expmap cluster demo` only; in production, use nginx or Caddy.

It routes each map to one server by rendezvous hashing while that server is ready, and to another one if it
does not respond. One request per connection, no TLS, no limits, no protection from slow clients.

    python -m webapp.cli.demo.proxy PORT NAME=HOST:PORT ...
"""

from __future__ import annotations

import asyncio
import hashlib
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import click

_OF_MAP = re.compile(r"/(?:api/v1/)?(?:maps|missions)/([^/?#]+)")
_NOT_PASSED_ON = (
    "connection",
    "keep-alive",
    "expect",
    "x-forwarded-for",
    "x-forwarded-proto",
    "x-forwarded-host",
)
_REPEATABLE = ("GET", "HEAD", "OPTIONS")

_BLOCK, _LONGEST_HEAD = 1 << 16, 1 << 16
_CONNECT_S, _PROBE_S = 2.0, 0.5

_UNAVAILABLE = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\nContent-Length: 24\r\n"
    b"Retry-After: 1\r\nConnection: close\r\n\r\nno server has answered.\n"
)


@dataclass(slots=True)
class Upstream:
    """A server that requests are forwarded to."""

    name: str
    host: str
    port: int
    ready: bool = True


@dataclass(frozen=True, slots=True)
class _Head:
    """The request line and headers of a request, as they are forwarded."""

    method: str
    path: str
    expects: bool
    has_body: bool
    lines: bytes


def in_order(upstreams: Sequence[Upstream], key: str) -> list[Upstream]:
    """Sort servers by rendezvous hashing for a key; those that are ready come first."""

    def rank(one: Upstream) -> tuple[bool, bytes]:
        return not one.ready, hashlib.sha256(f"{key}\0{one.name}".encode()).digest()

    return sorted(upstreams, key=rank)


class Proxy:
    """Forwards requests to its servers."""

    def __init__(self, upstreams: Sequence[Upstream]) -> None:
        self._upstreams = upstreams

    async def serve(self, port: int) -> None:
        """Serve until cancelled; prints the address once it listens."""
        server = await asyncio.start_server(self._answer, "127.0.0.1", port, limit=_LONGEST_HEAD)
        probing = [asyncio.create_task(self._keep_probing(one)) for one in self._upstreams]
        click.echo(f"listening on http://127.0.0.1:{server.sockets[0].getsockname()[1]}")
        async with server:
            await asyncio.gather(server.serve_forever(), *probing)

    async def _keep_probing(self, one: Upstream) -> None:
        """Poll a server's readiness."""
        while True:
            was, one.ready = one.ready, await _is_ready(one)
            if was != one.ready:
                click.echo(f"{one.name} is {'ready' if one.ready else 'not ready'}", err=True)
            await asyncio.sleep(_PROBE_S)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = writer.get_extra_info("peername")[0]
        with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ValueError):
            head = _read_head(await reader.readuntil(b"\r\n\r\n"), client=client)
            if head.expects:
                writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
            found = _OF_MAP.match(head.path)
            for one in in_order(self._upstreams, found[1] if found else client):
                if await _pass_on(head, reader, writer, to=one):
                    break
            else:
                writer.write(_UNAVAILABLE)
                await writer.drain()
        writer.close()


def _read_head(raw: bytes, *, client: str) -> _Head:
    """Parse the head of a request; raises ValueError if it is malformed."""
    first, *fields = raw.decode("latin-1").removesuffix("\r\n\r\n").split("\r\n")
    method, path, _ = first.split(" ")
    named = {line.partition(":")[0].strip().lower(): line.partition(":")[2].strip() for line in fields}
    kept = [line for line in fields if line.partition(":")[0].strip().lower() not in _NOT_PASSED_ON]
    own = (
        f"X-Forwarded-For: {client}",
        "X-Forwarded-Proto: http",
        f"X-Forwarded-Host: {named.get('host', '')}",
        "Connection: close",
    )
    lines = "\r\n".join((first, *kept, *own, "", "")).encode("latin-1")
    has_body = named.get("content-length", "0") != "0" or "transfer-encoding" in named
    return _Head(method, path, "expect" in named, has_body, lines)


async def _pass_on(
    head: _Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, to: Upstream
) -> bool:
    """Forward a request and return the response; returns False if another server should be tried."""
    try:
        there, out = await asyncio.wait_for(asyncio.open_connection(to.host, to.port), _CONNECT_S)
    except OSError:
        to.ready = False
        return False
    sending = asyncio.create_task(_copy(reader, out, first=head.lines))
    try:
        begin = await there.readline()
        if not begin:
            return _must_not_repeat(head, to)
        writer.write(begin + f"X-Answered-By: {to.name}\r\n".encode())
        await _copy(there, writer)
    except ConnectionResetError:
        return _must_not_repeat(head, to)
    finally:
        sending.cancel()
        out.close()
    return True


def _must_not_repeat(head: _Head, to: Upstream) -> bool:
    """Mark a server that died as not ready; return True if the request must not be sent to another one."""
    to.ready = False
    return head.has_body or head.method not in _REPEATABLE


async def _copy(source: asyncio.StreamReader, target: asyncio.StreamWriter, *, first: bytes = b"") -> None:
    """Copy until the source ends or the target disconnects."""
    with suppress(ConnectionError):
        target.write(first)
        await target.drain()
        while block := await source.read(_BLOCK):
            target.write(block)
            await target.drain()


async def _is_ready(one: Upstream) -> bool:
    try:
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(one.host, one.port)
            writer.write(b"GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            status = await reader.readline()
            writer.close()
    except OSError:
        return False
    return b" 200 " in status


def main(arguments: Sequence[str]) -> None:
    """Run the proxy."""
    port, *nodes = arguments
    upstreams = []
    for node in nodes:
        name, _, address = node.partition("=")
        host, _, number = address.rpartition(":")
        upstreams.append(Upstream(name, host, int(number)))
    with suppress(KeyboardInterrupt):
        asyncio.run(Proxy(upstreams).serve(int(port)))


if __name__ == "__main__":
    main(sys.argv[1:])
