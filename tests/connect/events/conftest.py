"""The web application, a worker that delivers, and an HTTP server that receives."""

import threading
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.web.conftest import (
    app,
    client,
    library,
    new_account,
    new_map,
    owner,
    park,
    sign_in,
    stranger,
)
from webapp.app.registry import REGISTRY
from webapp.jobs.worker import Worker
from webapp.settings import EventSettings, Settings

__all__ = [
    "app",
    "client",
    "library",
    "new_account",
    "new_map",
    "owner",
    "park",
    "sign_in",
    "stranger",
]
API = "/api/v1/account/events"
ALL = ["robot.silent", "robot.heard", "job.failed", "share.made", "share.invited"]


class Hook:
    """An HTTP server that keeps what it gets; `status` and `headers` are of its answers."""

    def __init__(self):
        self.got, self.status, self.headers, self.wait_s = [], 200, {}, 0.0
        hook = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                hook.got.append((self.path, dict(self.headers), body))
                time.sleep(hook.wait_s)
                self.send_response(hook.status)
                for name, value in hook.headers.items():
                    self.send_header(name, value)
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/hook"
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
        self.thread.start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()


@pytest.fixture
def hook():
    server = Hook()
    yield server
    server.close()


@pytest.fixture
def settings(tmp_path, database_url):
    allowed = EventSettings(private_hosts="127.0.0.1", site="https://maps.example.org", timeout_s=1.0)
    return Settings(library=tmp_path / "library", database=database_url, events=allowed)


@pytest.fixture
def work(library, settings):
    """Do what is due, as a worker would; settings can be changed."""

    def do(**changed):
        used = replace(settings, **changed)
        Worker(library, used, registry=REGISTRY).run(once=True)

    return do


@pytest.fixture
def add(client):
    """Add a receiver of the owner and return it as from the API."""

    def make(kind, address, events=ALL):
        answer = client.post(API, json={"kind": kind, "address": address, "events": events})
        assert answer.status_code == 201, answer.text
        return answer.json

    return make


@pytest.fixture
def messages(client):
    """Return the states of the owner's messages, the oldest first."""
    return lambda: [one["state"] for one in reversed(client.get(API).json["messages"])]
