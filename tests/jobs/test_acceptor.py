"""The acceptor: health checks that wait for nothing, and connections passed to web processes."""

import http.client
import selectors
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import replace

import pytest

from webapp.jobs import acceptor as module
from webapp.jobs.acceptor import CAN_PASS, Acceptor, connection_queue

pytestmark = pytest.mark.skipif(not CAN_PASS, reason="connections are passed on Linux only")

GENEROUS_S = 30.0


class Server:
    """An acceptor and its address."""

    def __init__(self, acceptor, listener):
        self.acceptor, self.address = acceptor, listener.getsockname()
        self.draining = threading.Event()

    def ask(self, path, method="GET"):
        """Return the status and the body."""
        connection = http.client.HTTPConnection(*self.address, timeout=GENEROUS_S)
        connection.request(method, path)
        response = connection.getresponse()
        return response.status, response.read()

    def connect(self, sent=b""):
        """Return a connection that has sent something."""
        connection = socket.create_connection(self.address)
        connection.settimeout(GENEROUS_S)
        connection.sendall(sent)
        return connection

    def take(self):
        """Take a connection, as a web process does."""
        with selectors.DefaultSelector() as selector:
            selector.register(self.acceptor.receiving_end, selectors.EVENT_READ)
            assert selector.select(GENEROUS_S), "no connection was passed on"
        connection, _ = self.acceptor.receiving_end.accept()
        connection.settimeout(GENEROUS_S)
        return connection


@pytest.fixture
def server(library, settings):
    settings = replace(settings, serve=replace(settings.serve, patience_s=0.5, job_workers=0))
    draining = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        made = Acceptor(listener, library, settings=settings, draining=draining.is_set)
        with made as acceptor:
            server = Server(acceptor, listener)
            server.draining = draining
            yield server


def test_without_a_web_process_the_server_lives_but_is_not_ready(server):
    assert server.ask("/livez") == (200, b'{"status": "ok"}\n')
    assert server.ask("/readyz") == (503, b'{"status": "failing"}\n')
    status, body = server.ask("/healthz")
    assert status == 503
    assert b'"web": "failing", "database": "ok"' in body


def test_a_request_is_passed_on_as_it_was_sent(server):
    sent = b"POST /api/v1/maps/park/localize HTTP/1.1\r\nHost: here\r\n\r\n"
    with server.connect(sent) as client, server.take() as taken:
        assert taken.recv(1000) == sent
        taken.sendall(b"answer")
        assert client.recv(1000) == b"answer"
        assert taken.getpeername() == client.getsockname()
    assert server.ask("/readyz") == (200, b'{"status": "ok"}\n')


def test_checks_are_answered_while_nobody_takes_requests(server, monkeypatch):
    with ExitStack() as stack:
        stack.enter_context(server.connect(b"GET /"))
        stack.enter_context(server.take())
        clients = [stack.enter_context(server.connect(b"GET / %d" % number)) for number in range(350)]
        assert server.ask("/healthz")[0] == 200
        monkeypatch.setattr(module, "_STUCK_S", 0.0)
        assert server.ask("/readyz")[0] == 503
        assert server.ask("/livez")[0] == 200
        sent = {stack.enter_context(server.take()).recv(100) for _ in clients}
        assert sent == {b"GET / %d" % number for number in range(350)}
        monkeypatch.undo()
        assert server.ask("/readyz")[0] == 200


@pytest.mark.parametrize("path", ["/healthzz", "/readyz/", "/api/v1/livez"])
def test_other_paths_are_passed_on(server, path):
    sent = f"GET {path} HTTP/1.1\r\n".encode()
    with server.connect(sent), server.take() as taken:
        assert taken.recv(1000) == sent


def test_other_methods_are_passed_on(server):
    with server.connect(b"POST /livez HTTP/1.1\r\n"), server.take() as taken:
        assert taken.recv(4) == b"POST"


def test_a_silent_connection_is_passed_on(server, monkeypatch):
    monkeypatch.setattr(module, "_SILENT_S", 0.01)
    with server.connect() as client, server.take() as taken:
        client.sendall(b"GET / HTTP/1.1\r\n")
        assert taken.recv(5) == b"GET /"


def test_a_head_request_has_no_body(server):
    with server.connect(b"HEAD /livez?a=1 HTTP/1.1\r\n\r\n") as client:
        answer = client.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 200 OK\r\n")
    assert answer.endswith(b"\r\n\r\n")


def test_checks_that_stop_half_way_delay_no_others_and_are_closed(server):
    with ExitStack() as stack:
        slow = [stack.enter_context(server.connect(b"GET /healthz HTTP/1.1\r\n")) for _ in range(50)]
        assert server.ask("/livez")[0] == 200
        assert [client.recv(1) for client in slow] == [b""] * 50


def test_an_endless_head_is_not_read(server):
    head = b"GET /livez HTTP/1.1\r\nA: " + b"a" * 20_000
    with server.connect(head) as client, suppress(ConnectionResetError):
        assert client.recv(1) == b""


def test_a_server_that_is_about_to_stop_says_so(server):
    server.draining.set()
    assert server.ask("/readyz") == (503, b'{"status": "draining"}\n')


def test_checks_at_the_same_time_share_one_look_at_the_database(server, library, monkeypatch):
    begun, go_on, looks = threading.Event(), threading.Event(), []

    def answers(_health):
        looks.append(time.monotonic())
        begun.set()
        return go_on.wait(GENEROUS_S)

    monkeypatch.setattr("webapp.jobs.health.Health._database_answers", answers)
    with ThreadPoolExecutor(8) as pool:
        waiting = [pool.submit(server.ask, "/healthz") for _ in range(8)]
        assert begun.wait(GENEROUS_S)
        assert server.ask("/livez")[0] == 200  # does not wait for the database
        go_on.set()
        assert all(b'"database": "ok"' in one.result()[1] for one in waiting)
    assert 1 <= len(looks) < 8


def test_a_web_process_notices_that_the_supervisor_is_gone():
    sending, receiving = connection_queue()
    with receiving:
        with pytest.raises(BlockingIOError):
            receiving.accept()
        sending.close()
        with pytest.raises(EOFError):
            receiving.accept()


def test_a_stopped_acceptor_leaves_what_is_in_the_queue(server):
    with server.connect(b"GET /"), selectors.DefaultSelector() as selector:
        selector.register(server.acceptor.receiving_end, selectors.EVENT_READ)
        assert selector.select(GENEROUS_S)
        server.acceptor.stop()
        assert not server.acceptor.is_running()
        with server.take() as taken:
            assert taken.recv(5) == b"GET /"
