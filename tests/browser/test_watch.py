"""The watch of browser contexts detects faults."""

import re
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.browser import axe
from tests.browser.watch import Watch

pytestmark = pytest.mark.slow

PAGE = '<!doctype html><html lang="en"><title>A page</title><main><h1>Here</h1>{}</main></html>'
BODIES = {
    "/good": "<p>Nothing is wrong.</p>",
    "/foreign": '<img alt="" src="http://192.0.2.1/picture.png">',
    "/console": '<script src="/console.js"></script>',
    "/script": '<script src="/script.js"></script>',
    "/inline": "<script>document.title = 'never'</script>",
    "/style": '<p style="color: red">red</p>',
    "/gone": '<script src="/missing.js"></script>',
    "/broken": '<img alt="" src="/error">',
    "/bare": '<button></button><img src="/good">',
}
SCRIPTS = {"/console.js": "console.error('it says so')", "/script.js": "nothing.at.all()"}


class Pages(BaseHTTPRequestHandler):
    """Pages with one fault each."""

    def do_GET(self):
        status, kind, text = 200, "text/html", PAGE.format(BODIES.get(self.path, ""))
        if self.path in SCRIPTS:
            kind, text = "text/javascript", SCRIPTS[self.path]
        elif self.path not in BODIES:
            status = 500 if self.path == "/error" else 404
        if self.path == "/favicon.ico":
            status = 204
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Security-Policy", "default-src 'self'; img-src *")
        self.end_headers()
        if status != 204:
            self.wfile.write(text.encode())

    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def pages():
    with ThreadingHTTPServer(("127.0.0.1", 0), Pages) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture
def watched(pages, browser):
    """Open a page of a watched context and return the watch and the page."""
    context = browser.new_context(base_url=pages)
    watch, page = Watch(context, pages), context.new_page()

    def visit(path):
        page.goto(path)
        page.wait_for_timeout(100)  # the browser reports it a little later
        return watch, page

    yield visit
    context.close()


@pytest.mark.parametrize(
    ("path", "fault"),
    [
        ("/foreign", "asks somebody else: http://192.0.2.1/picture.png"),
        ("/console", "it says so"),
        ("/script", "nothing is not defined"),
        ("/inline", "policy: script-src"),
        ("/style", "policy: style-src"),
        ("/gone", "404"),
        ("/broken", "500: GET"),
    ],
)
def test_a_fault_is_noticed(watched, path, fault):
    watch, page = watched(path)
    until = time.monotonic() + 60
    while not re.search(fault, "\n".join(watch.faults)) and time.monotonic() < until:
        page.wait_for_timeout(50)  # the browser reports it a little later
    with pytest.raises(AssertionError, match=fault):
        watch.check()


def test_a_good_page_passes(watched):
    watch, page = watched("/good")
    watch.check()
    assert axe.findings(page) == []


def test_an_expected_answer_is_no_fault(watched):
    watch, page = watched("/good")
    watch.expect(404)
    assert page.evaluate("fetch('/missing').then(answer => answer.status)") == 404
    watch.check()


def test_what_a_screen_reader_cannot_say_is_found(watched):
    _, page = watched("/bare")
    found = axe.findings(page)
    assert any("button-name" in line for line in found) and any("image-alt" in line for line in found)
