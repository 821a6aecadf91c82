"""The start of a server."""

import socket

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
