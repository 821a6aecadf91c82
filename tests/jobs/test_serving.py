"""The start of a server."""

import socket

from webapp.jobs.serving import _Start
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Limits


def test_a_second_machine_makes_no_second_sample_map(library, settings):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        _Start(library, listener, settings=settings)
        with library.database.write() as session:
            jobs.lease(session, "another machine", limits=Limits(seconds=60.0, attempts=3))
        _Start(library, listener, settings=settings)
    with library.database.read() as session:
        assert [job.kind for job in jobs.list_jobs(session)] == ["sample"]
