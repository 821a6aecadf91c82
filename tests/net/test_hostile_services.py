"""Services that misbehave: whatever they answer, each client ends soon, with an error in words."""

import socket
import time
from collections import Counter

import pytest

from tests.net.hostile_server import WAYS, hostile, pretending
from webapp.core.geo.tilegrid import Tile
from webapp.errors import InputError
from webapp.net import bounded, geocoder, polite, tiles
from webapp.net.polite import PoliteClient
from webapp.net.tiles import TileFetcher, TileService
from webapp.progress import Progress
from webapp.settings import GeocoderSettings, StreetSettings, TileSettings

TIMEOUT_S, PATIENT_S = 0.1, 5.0
"""The second where an answer has to arrive, also on a busy machine."""

WITHIN_S = 5.0


@pytest.fixture
def server():
    with hostile() as service:
        yield service


def _street():
    return StreetSettings(requests_per_second=1000.0, timeout_s=TIMEOUT_S)


def _tile(address, folder):
    service = TileService("Local", address + "/{z}/{x}/{y}", "©", 19)
    settings = TileSettings(requests_per_second=1000.0, timeout_s=TIMEOUT_S)
    fetcher = TileFetcher(service, cache=folder, settings=settings)
    return list(fetcher.fetch([Tile(1, 1)], zoom=3, progress=Progress()))


def _place(address, _):
    return geocoder.search(
        "x", language="en", settings=GeocoderSettings(address=address, timeout_s=TIMEOUT_S)
    )


def _list(address, _):
    return PoliteClient("Service", address, settings=_street()).json(f"{address}/x")


def _photo(address, _):
    return PoliteClient("Service", address, settings=_street()).photo(f"{address}/x", max_bytes=100_000)


def _model(address, _):
    return bounded.download(address, size=900, progress=Progress())


CLIENTS = {"tile": _tile, "place": _place, "list": _list, "photo": _photo, "model": _model}
CASES = [
    (c, w) for c in CLIENTS for w in WAYS if c != "photo" or w not in ("a negative length", "two lengths")
]
"""Of any client and answer, except short bodies, which are photos until somebody opens them."""

MOST_BYTES = {"tile": 4e6, "place": 1e6, "list": 50e6, "photo": 1e5, "model": 900}


@pytest.fixture(autouse=True)
def once(monkeypatch):
    """No request is repeated, and downloads have the timeout of the others."""
    monkeypatch.setattr(tiles, "_TRIES", 1)
    monkeypatch.setattr(polite, "_TRIES", 1)
    monkeypatch.setattr(bounded, "_TIMEOUT_S", TIMEOUT_S)


@pytest.fixture
def patient(monkeypatch):
    monkeypatch.setattr(f"{__name__}.TIMEOUT_S", PATIENT_S)


@pytest.mark.parametrize(("client", "way"), CASES)
def test_every_answer_ends_in_an_error(server, tmp_path, client, way):
    server.answer = WAYS[way]
    started = time.monotonic()
    with pytest.raises(InputError) as raised:
        CLIENTS[client](server.address, tmp_path)
    assert time.monotonic() - started < WITHIN_S
    assert "\n" not in str(raised.value) and str(raised.value)
    assert server.asked == 1
    # sockets and their buffers hold some MB more than was read
    assert server.sent < MOST_BYTES[client] + 20e6


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_no_redirect_leads_to_another_host(server, tmp_path, client, status, patient):
    with hostile() as other:
        head = f"HTTP/1.1 {status} Moved\r\nLocation: {other.address}/\r\nContent-Length: 0\r\n\r\n"
        server.answer = lambda: [head.encode()]
        with pytest.raises(InputError):
            CLIENTS[client](server.address, tmp_path)
        assert (server.asked, other.asked) == (1, 0)


@pytest.mark.parametrize("client", ["list", "photo"])
def test_redirects_in_a_circle_end(server, tmp_path, client, patient):
    head = f"HTTP/1.1 302 Moved\r\nLocation: {server.address}/x\r\nConnection: close\r\n\r\n"
    server.answer = lambda: [head.encode()]
    with pytest.raises(InputError, match="redirects too many times"):
        CLIENTS[client](server.address, tmp_path)
    assert server.asked == 4


def test_a_service_cannot_make_a_tile_wait_for_hours(server, tmp_path, monkeypatch, patient):
    """Where a service demands a pause of a year, the tile is requested again after a minute at most."""
    monkeypatch.setattr(tiles, "_TRIES", 2)
    pauses = []
    monkeypatch.setattr("urllib3.util.retry.time.sleep", pauses.append)
    server.answer = lambda: [b"HTTP/1.1 503 Busy\r\nRetry-After: 31536000\r\nContent-Length: 0\r\n\r\n"]
    with pytest.raises(InputError, match="answered 503"):
        CLIENTS["tile"](server.address, tmp_path)
    assert [pause for pause in pauses if pause > 1.0] == [60]


def test_a_slow_answer_that_is_fast_enough_arrives(server, tmp_path, monkeypatch):
    """A large answer may take longer than two timeouts, as long as it advances."""
    monkeypatch.setattr(bounded, "_TIMEOUT_S", 0.5)
    monkeypatch.setattr(bounded, "_SLOWEST", 100.0)

    def answer():
        yield b"HTTP/1.1 200 OK\r\nContent-Length: 900\r\n\r\n"
        for _ in range(9):
            time.sleep(0.15)
            yield b"x" * 100

    server.answer = answer
    assert CLIENTS["model"](server.address, tmp_path) == b"x" * 900


def test_a_host_name_that_leads_home_gets_no_request(tmp_path, monkeypatch, patient):
    """DNS rebinding: where the name of a photo host points to this machine, its certificate is missing."""
    asked = Counter()
    resolve = socket.getaddrinfo
    with pretending("x.fbcdn.net", tmp_path) as (port, requests):

        def rebound(host, _port, *rest, **options):
            asked[host] += 1
            return resolve("127.0.0.1", port, *rest, **options)

        monkeypatch.setattr(socket, "getaddrinfo", rebound)
        client = PoliteClient("Service", "https://graph.example", settings=_street())
        with pytest.raises(InputError, match=r"cannot be reached \(SSLError\)"):
            client.photo("https://x.fbcdn.net/p.jpg", max_bytes=100)
        assert asked["x.fbcdn.net"] == 1 and requests == []
