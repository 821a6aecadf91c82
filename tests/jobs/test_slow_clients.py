"""Silent connections: how long the web server keeps them."""

import selectors
import socket
import time
from collections import deque

import pytest

from webapp.jobs.slow_clients import Connection, PatientWorker


@pytest.fixture
def worker():
    """A worker of at most ten connections that neither reads nor accepts."""
    worker = PatientWorker.__new__(PatientWorker)
    worker.alive, worker.worker_connections, worker.nr_conns = True, 10, 0
    worker.pending_conns, worker.poller = deque(), selectors.DefaultSelector()
    yield worker
    worker.poller.close()


@pytest.fixture
def silent(worker):
    """A connection of that worker whose time for a request is over, but not yet its idle timeout."""
    here, there = socket.socketpair()
    connection = Connection.__new__(Connection)
    connection.sock, connection.patient_until = here, time.monotonic() - 1
    connection.timeout = connection.patient_until + 60
    worker.poller.register(here, selectors.EVENT_READ)
    worker.pending_conns.append(connection)
    worker.nr_conns = 1
    yield connection
    here.close()
    there.close()


@pytest.mark.parametrize(
    ("connections", "alive", "kept"),
    [(5, True, True), (6, True, False), (1, False, False)],
    ids=["there is room", "many are open", "the server stops"],
)
def test_a_silent_connection_is_kept_where_it_is_in_nobodys_way(worker, silent, connections, alive, kept):
    worker.nr_conns, worker.alive = connections, alive
    worker.murder_pending()
    assert (silent in worker.pending_conns) is kept
    assert (silent.sock.fileno() == -1) is not kept
    assert worker.nr_conns == connections - (not kept)
