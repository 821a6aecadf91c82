"""An OpenTelemetry collector gets all spans of a process, including the last ones."""

import os
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest


@pytest.fixture
def collector():
    """The address of a server that accepts OTLP over HTTP, and what it received."""
    service = pytest.importorskip("opentelemetry.proto.collector.trace.v1.trace_service_pb2")
    got = []

    class Collector(BaseHTTPRequestHandler):
        def do_POST(self):
            sent = self.rfile.read(int(self.headers["Content-Length"]))
            got.append((self.path, service.ExportTraceServiceRequest.FromString(sent)))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Collector) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_port}", got
        server.shutdown()


def test_a_worker_sends_the_span_of_a_job_before_it_ends(library, queue, seen, collector):
    address, got = collector
    job = queue("describe-library")
    command = [sys.executable, "-m", "webapp", "worker", "--once", "--library", library.folder]
    subprocess.run(command, check=True, timeout=120, env={**os.environ, "EXPMAP_TRACES": address})
    assert seen(job)["state"] == "done"
    ((path, request),) = got
    (resource,) = request.resource_spans
    service = {one.key: one.value.string_value for one in resource.resource.attributes}
    (span,) = resource.scope_spans[0].spans
    values = {one.key: one.value.int_value for one in span.attributes}
    assert (path, service["service.name"]) == ("/v1/traces", "experience-map")
    assert (span.name, values["expmap.job"], values["expmap.attempt"]) == ("job describe-library", job, 1)
