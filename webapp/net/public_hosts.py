"""Connections to hosts that users name: never into a private network, whatever a name resolves to.

The address is checked that the connection is then made to. A name that resolves to another address a moment
later therefore gains nothing.
"""

from __future__ import annotations

import ipaddress
import socket
from contextvars import ContextVar
from ipaddress import IPv4Address, IPv6Address
from typing import Any, NamedTuple

import requests
from urllib3 import HTTPConnectionPool, HTTPSConnectionPool
from urllib3.util import connection as urllib3_connection

from webapp.errors import InputError
from webapp.net.bounded import (
    BoundedAdapter,
    BoundedConnection,
    BoundedSecureConnection,
    bounded_session,
)

_NAT64 = ipaddress.ip_network("64:ff9b::/96")
_policy: ContextVar[Policy] = ContextVar("allowed_private_hosts")


class Policy(NamedTuple):
    """Which private addresses are accepted."""

    allowed: str  # Hosts and networks, separated by commas
    setting: str  # Name of the setting that allows them


def public_session(
    user_agent: str, *, allowed: str | None, setting: str = "events.private_hosts"
) -> requests.Session:
    """Make a session that connects to public addresses only, without a proxy.

    Args:
        allowed: Hosts and networks that are accepted in addition, separated by commas.
        setting: Name of the setting that they are from.
    """
    session = bounded_session(user_agent, _PublicAdapter(Policy(allowed or "", setting)))
    session.trust_env = False  # a proxy would resolve the names itself; no passwords of a .netrc
    return session


def resolve(host: str, port: int, *, allowed: str, setting: str = "events.private_hosts") -> list[str]:
    """Return the IP addresses of a host, all of which are public or allowed.

    Raises:
        InputError: One is neither.
        OSError: The name cannot be resolved.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    addresses = list(dict.fromkeys(str(entry[4][0]) for entry in found))
    own = [one.strip().lower() for one in allowed.split(",") if one.strip()]
    for address in addresses:
        ip = ipaddress.ip_address(address.partition("%")[0])
        if not _is_public(ip) and host.lower().rstrip(".") not in own and not _is_within(ip, own):
            raise InputError(
                f"{host} is at {address}, which is not a public address",
                hint=f"the operator of the server can allow it: {setting}",
            )
    return addresses


def _is_public(ip: IPv4Address | IPv6Address) -> bool:
    """Return whether an address, and the IPv4 address that it may contain, belongs to the public internet."""
    if isinstance(ip, IPv6Address):
        inner = [ip.ipv4_mapped, ip.sixtofour, *(ip.teredo or ())]
        if ip in _NAT64:
            inner.append(IPv4Address(int(ip) & 0xFFFF_FFFF))
        given = [one for one in inner if one is not None]
        if given:
            return all(map(_is_public, given))
    return ip.is_global and not ip.is_multicast


def _is_within(ip: IPv4Address | IPv6Address, allowed: list[str]) -> bool:
    for one in allowed:
        try:
            if ip in ipaddress.ip_network(one, strict=False):
                return True
        except ValueError:
            continue  # the name of a host
    return False


class _PublicAdapter(BoundedAdapter):
    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        super().__init__()

    def init_poolmanager(self, *args: Any, **options: Any) -> None:
        super().init_poolmanager(*args, **options)
        self.poolmanager.pool_classes_by_scheme = {"http": _Pool, "https": _SecurePool}

    def send(self, *args: Any, **options: Any) -> requests.Response:
        token = _policy.set(self._policy)
        try:
            return super().send(*args, **options)
        finally:
            _policy.reset(token)


class _ToPublic:
    """Makes the socket of a connection."""

    _dns_host: str
    port: int
    timeout: Any
    source_address: Any
    socket_options: Any

    def _new_conn(self) -> socket.socket:
        last: OSError | None = None
        allowed, setting = _policy.get()
        for address in resolve(self._dns_host, self.port, allowed=allowed, setting=setting):
            try:
                return urllib3_connection.create_connection(
                    (address, self.port),
                    self.timeout,
                    source_address=self.source_address,
                    socket_options=self.socket_options,
                )
            except OSError as error:
                last = error
        raise last or OSError("the name has no address")


class _Connection(_ToPublic, BoundedConnection):
    pass


class _SecureConnection(_ToPublic, BoundedSecureConnection):
    pass


class _Pool(HTTPConnectionPool):
    ConnectionCls = _Connection


class _SecurePool(HTTPSConnectionPool):
    ConnectionCls = _SecureConnection
