"""A client that has left is noticed while its request is worked on."""

import socket

import pytest

from webapp.web.clients import ClientProgress


@pytest.fixture
def connection():
    server, client = socket.socketpair()
    with server, client:
        yield server, client


def test_a_client_that_leaves_cancels_its_work(app, connection):
    server, client = connection
    with app.test_request_context(environ_overrides={"gunicorn.socket": server}):
        progress = ClientProgress()
        assert not progress.cancelled()
        client.send(b"the next request")
        assert not progress.cancelled()
        assert server.recv(100) == b"the next request", "it was not taken away"
        client.close()
        assert progress.cancelled()


def test_without_a_connection_nobody_leaves(app):
    with app.test_request_context():
        assert not ClientProgress().cancelled()
