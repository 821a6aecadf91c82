"""The job that fetches models, from a server of the test; maps then get their second index."""

import hashlib
import threading
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from webapp.app.registry import REGISTRY
from webapp.core.features.entry import ModelFile
from webapp.files.localize.models import MODELS
from webapp.jobs.worker import Worker
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.operate.models import queue_second_looks

CONTENT = bytes(range(256)) * 100


@pytest.fixture
def host():
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Length", str(len(CONTENT)))
            self.end_headers()
            self.wfile.write(CONTENT)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture
def settings(settings, tmp_path, host, monkeypatch):
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    for name in ("xfeat", "lighterglue"):
        file = ModelFile(f"{name}.onnx", len(CONTENT), sha256, "MIT", "the test", f"{host}/{name}")
        monkeypatch.setitem(MODELS, name, (file,))
    return replace(settings, models=tmp_path / "models")


@pytest.fixture
def indexed(library, queue, park):
    """The id of a map whose index job has ended."""
    id = queue("index", map_id=park)
    with library.database.write() as session:
        job = jobs.find(session, id)
        job.state, job.ended_at = "done", jobs.moment(session)
    time.sleep(0.05)
    return park


def index_jobs(library):
    with library.database.read() as session:
        return [job.state for job in session.query(Job).where(Job.kind == "index")]


def test_it_fetches_what_is_missing_and_maps_get_their_second_index(library, settings, queue, seen, indexed):
    id = queue("models", arguments={"models": ["xfeat", "lighterglue"]})
    work = Worker(library, settings, registry=REGISTRY)
    assert queue_second_looks(library, settings) == 0
    assert work._turn(once=True)
    assert seen(id)["state"] == "done", seen(id)["error"]
    assert seen(id)["result"] == {"fetched": ["xfeat", "lighterglue"], "maps": 1}
    assert (settings.models / "lighterglue.onnx").read_bytes() == CONTENT
    assert index_jobs(library) == ["done", "queued"]
    assert queue_second_looks(library, settings) == 0  # one is enough


def test_a_wrong_file_is_not_kept(library, settings, queue, seen, monkeypatch):
    monkeypatch.setitem(MODELS, "xfeat", (replace(MODELS["xfeat"][0], sha256="0" * 64),))
    id = queue("models", arguments={"models": ["xfeat"]})
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert seen(id)["state"] == "failed" and "not the published file" in seen(id)["error"]["message"]
    assert not settings.models.exists()
