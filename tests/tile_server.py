"""A local map tile service that draws crosses at known places on the Earth."""

import io
import math
import threading
import time
from collections import Counter
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler

import numpy as np
from PIL import Image

from tests.http_server import QuietHandler, running

ARM = 3
RED = (255, 0, 0)


def global_pixel(lat, lon, zoom):
    """Return the global pixel at a zoom, by the formula of slippy maps."""
    size = 256 * 2**zoom
    x = (lon + 180) / 360 * size
    y = (1 - math.asinh(math.tan(math.radians(lat))) / math.pi) / 2 * size
    return math.floor(x), math.floor(y)


class TileServer:
    """Serves `/{z}/{x}/{y}`; faults can be chosen.

    `landmarks` are (lat, lon); each becomes a red cross centred on the pixel that contains the place.
    """

    def __init__(self):
        self.landmarks = []
        self.missing = set()
        self.failing = Counter()
        self.asked = Counter()
        self.agents = set()
        self.format = "PNG"
        self.size = 256
        self.delay_s = 0.0
        self.body = None
        self.status = 200
        self.at_once, self.most_at_once = 0, 0
        self.lock = threading.Lock()
        self.port = None

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}/{{z}}/{{x}}/{{y}}"

    def draw(self, z, x, y):
        """Draw a tile with an individual tint, and the crosses inside it."""
        pixels = np.full((self.size, self.size, 3), (60 + 40 * (x % 3), 120, 60 + 40 * (y % 3)), np.uint8)
        for lat, lon in self.landmarks:
            column, row = (v - 256 * t for v, t in zip(global_pixel(lat, lon, z), (x, y), strict=True))
            for dx, dy in [(d, 0) for d in range(-ARM, ARM + 1)] + [(0, d) for d in range(-ARM, ARM + 1)]:
                if 0 <= column + dx < self.size and 0 <= row + dy < self.size:
                    pixels[row + dy, column + dx] = RED
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, format=self.format)
        return buffer.getvalue()

    def answer(self, path):
        """Return status and body for a path."""
        with self.lock:
            self.at_once += 1
            self.most_at_once = max(self.most_at_once, self.at_once)
            self.asked[path] += 1
            fails = self.failing[path] > 0
            self.failing[path] -= fails
        try:
            time.sleep(self.delay_s)
            if fails:
                return 503, b"busy"
            z, x, y = (int(part) for part in path.strip("/").split("/"))
            if (z, x, y) in self.missing:
                return 404, b"none"
            return self.status, self.draw(z, x, y) if self.body is None else self.body
        finally:
            with self.lock:
                self.at_once -= 1


@contextmanager
def serving():
    """Run a server during the block."""
    tiles = TileServer()

    class Handler(QuietHandler, BaseHTTPRequestHandler):
        def do_GET(self):
            tiles.agents.add(self.headers["User-Agent"])
            status, body = tiles.answer(self.path)
            self.send_response(status)
            if status in (301, 302):
                self.send_header("Location", "http://127.0.0.1:1/elsewhere")
            self.send_header("Access-Control-Allow-Origin", "*")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    with running(Handler) as tiles.port:
        yield tiles
