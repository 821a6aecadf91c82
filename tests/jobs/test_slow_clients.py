"""Silent connections: how long the web server keeps them; and the threads of slow requests."""

import selectors
import socket
import threading
import time
from collections import deque
from concurrent.futures import Future
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from gunicorn.workers.gthread import PollableMethodQueue, ThreadWorker

from webapp.jobs.webserver import ClientSocket, Connection, PatientWorker


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
    connection.sock, connection.parser, connection.patient_until = here, None, time.monotonic() - 1
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


@pytest.mark.parametrize(
    ("request_", "connections", "idle_s", "closed", "answered"),
    [
        (b"", 1, 20, False, False),
        (b"", 6, 20, True, False),
        (b"", 1, 80, True, False),
        (b"GET /maps HTTP/1.1\r\n", 1, 80, False, True),
    ],
    ids=["there is room", "many are open", "idle for long", "its next request has just arrived"],
)
def test_a_kept_connection_is_not_closed_under_a_request(
    worker, request_, connections, idle_s, closed, answered
):
    here, there = socket.socketpair()
    connection = Connection.__new__(Connection)
    connection.sock, connection.parser, connection.cfg = here, None, SimpleNamespace(keepalive=75)
    connection.set_timeout()
    connection.timeout -= idle_s
    connection.patient_until -= idle_s
    worker.keepalived_conns = deque([connection])
    worker.poller.register(here, selectors.EVENT_READ)
    worker.nr_conns = connections
    passed_on = []
    worker.enqueue_req = passed_on.append
    with here, there:
        there.sendall(request_)
        worker.murder_keepalived()
        assert (here.fileno() == -1) is closed
        assert (passed_on == [connection]) is answered
        assert (connection in worker.keepalived_conns) is not (closed or answered)


def test_requests_that_localize_leave_the_threads_to_others(worker):
    worker.cfg, worker.method_queue = SimpleNamespace(threads=1), PollableMethodQueue()
    worker.method_queue.init()
    worker.tpool = worker.get_thread_pool()
    localized, answered = threading.Event(), threading.Event()
    worker.handle = lambda connection: (localized.wait if connection.localizes else answered.set)()
    with ExitStack() as stack:
        stack.callback(worker.method_queue.close)
        stack.callback(localized.set)
        for request in [b"POST /api/v1/maps/park/localize HTTP/1.1\r\n"] * 3 + [b"GET /maps HTTP/1.1\r\n"]:
            connection = Connection.__new__(Connection)
            here, there = (stack.enter_context(end) for end in socket.socketpair())
            connection.sock, connection.parser = ClientSocket(fileno=here.detach()), None
            connection.localizes = b"localize" in request
            stack.enter_context(connection.sock)
            there.sendall(request)
            worker.enqueue_req(connection)
        assert answered.wait(30)
        assert not localized.is_set()


def test_a_closing_connection_is_waited_for_in_the_thread_of_its_request(worker, monkeypatch):
    monkeypatch.setattr(ThreadWorker, "handle", lambda self, connection: False)
    here, there = socket.socketpair()
    connection = Connection.__new__(Connection)
    connection.sock, worker.nr_conns = ClientSocket(fileno=here.detach()), 1
    with there:
        there.sendall(b"the rest of a body")
        start = time.monotonic()
        assert worker.handle(connection) is False
        assert time.monotonic() - start < 5.0, "much less than for a request"
        assert connection.sock.fileno() == -1
        assert there.recv(1) == b"", "not reset"
        answered = Future()
        answered.set_result(False)
        worker.finish_request(connection, answered)
    assert worker.nr_conns == 0
