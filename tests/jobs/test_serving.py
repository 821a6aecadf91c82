"""The start of a server."""

import socket
from types import SimpleNamespace

import pytest

from webapp.jobs import serving
from webapp.jobs.serving import _Start
from webapp.progress import Progress
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits


def test_a_second_machine_makes_no_second_sample_map(library, settings):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        _Start(library, listener, settings=settings)
        with library.database.write() as session:
            jobs.lease(session, "another machine", limits=Limits(seconds=60.0, attempts=3))
        _Start(library, listener, settings=settings)
    with library.database.read() as session:
        assert [job.kind for job in jobs.list_jobs(session)] == ["sample"]


class Shown(Progress):
    """Keeps what was shown."""

    def __init__(self):
        self.seen = []

    def size(self, total):
        self.seen.append(("size", total))

    def advance(self, steps=1):
        self.seen.append(("advance", steps))


def test_a_first_start_shows_how_far_the_sample_map_is(library, settings, monkeypatch, caplog):
    monkeypatch.setattr(serving, "_POLL_S", 0.0)
    shown = Shown()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        start, told = (_Start(library, listener, settings=settings, progress=one) for one in (shown, None))
        with library.database.write() as session:
            job = jobs.lease(session, "a", limits=Limits(seconds=60.0, attempts=3))
            held = Lease(job.id, job.fence)
        for done in (2, 5):
            with library.database.write() as session:
                jobs.beat(session, held, seconds=60.0, progress=(done, 10, ""))
            with caplog.at_level("INFO"):
                assert not start._sample_is_made() and not told._sample_is_made()
        assert shown.seen == [("size", 10), ("advance", 2), ("advance", 3)]
        assert "making the sample map: 2 of 10 steps" in caplog.text
        with library.database.write() as session:
            jobs.finish(session, held)
        assert start._sample_is_made()


@pytest.mark.parametrize(
    ("there", "lines"),
    [
        ("192.168.1.7", ["listening on http://127.0.0.1:{}", "on other machines of this network: http://192.168.1.7:{}/sign-in/",
                         "sign in: http://127.0.0.1:{}/sign-in/"]),
        (None, ["listening on http://127.0.0.1:{}", "sign in: http://127.0.0.1:{}/sign-in/"]),
    ],
)  # fmt: skip
def test_a_server_for_a_network_prints_its_address_there(library, settings, monkeypatch, there, lines):
    monkeypatch.setattr(serving, "_network_address", lambda _family: there)
    monkeypatch.setattr(_Start, "_answers", lambda _self: True)
    printed = []
    with socket.create_server(("0.0.0.0", 0)) as listener:
        start = _Start(library, listener, settings=settings)
        start._sample = None
        start.poll(SimpleNamespace(failures=0), echo=printed.append)
        port = listener.getsockname()[1]
    assert len(printed) == len(lines)
    assert all(a.startswith(b.format(port)) for a, b in zip(printed, lines, strict=True))


def test_the_address_in_the_network_is_one_of_this_machine():
    found = serving._network_address(socket.AF_INET)
    if found is not None:
        with socket.create_server((found, 0)) as listener:
            assert listener.getsockname()[0] == found
