"""A local stand-in for Nominatim, the search for places."""

import json
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from urllib.parse import parse_qs, urlsplit

from tests.http_server import QuietHandler, running

LUND = {
    "lat": "55.7029",
    "lon": "13.1929",
    "display_name": "Lund, Lunds kommun, Sverige",
    "boundingbox": ["55.68", "55.74", "13.14", "13.25"],
}


class GeocoderServer:
    """Knows Lund; other responses can be set."""

    def __init__(self):
        self.asked = []
        self.agents = set()
        self.times = []
        self.status = 200
        self.body = None
        self.port = None

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/search"

    def answer(self, query):
        """Return the response body for a query."""
        found = [LUND] if "lund" in query["q"][0].casefold() else []
        return json.dumps(found).encode() if self.body is None else self.body


@contextmanager
def geocoding():
    """Run a server during the block."""
    geocoder = GeocoderServer()

    class Handler(QuietHandler, BaseHTTPRequestHandler):
        def do_GET(self):
            geocoder.times.append(time.monotonic())
            geocoder.agents.add(self.headers["User-Agent"])
            query = parse_qs(urlsplit(self.path).query)
            geocoder.asked.append(query)
            body = geocoder.answer(query)
            self.send_response(geocoder.status)
            if geocoder.status in (301, 302):
                self.send_header("Location", "http://127.0.0.1:1/elsewhere")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    with running(Handler) as geocoder.port:
        yield geocoder
