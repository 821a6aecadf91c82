"""Local stand-ins for street-level services with the APIs of Panoramax and Mapillary."""

import io
import json
import threading
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from urllib.parse import parse_qs, urlsplit

import numpy as np
from PIL import Image

from tests.http_server import QuietHandler, running

TOKEN = "MLY|1|secret"


@dataclass
class Shot:
    """A photo of the service; `fields` are added to its metadata."""

    id: str
    lat: float
    lon: float
    azimuth: float | None = 90.0
    panorama: bool = False
    fields: dict = field(default_factory=dict)


def picture(id, *, panorama=False):
    """Return a JPEG that is unique for the id."""
    seed = np.frombuffer(id.encode().ljust(8, b"\0")[-8:], np.uint64)[0]
    size = (20, 40, 3) if panorama else (12, 16, 3)
    pixels = np.random.default_rng(int(seed)).integers(0, 256, size, np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).resize((size[1] * 8, size[0] * 8)).save(file, "JPEG")
    return file.getvalue()


class StreetServer:
    """Serves `shots`; faults can be chosen.

    `asked` counts requests by path; `failing` has statuses that a path returns first, `bodies` replaced
    content, `cut` paths whose content is truncated.
    """

    def __init__(self, shots):
        self.shots = list(shots)
        self.asked = Counter()
        self.queries = []
        self.agents = set()
        self.tokens = Counter()
        self.failing = {}
        self.retry_after = None
        self.bodies = {}
        self.cut = set()
        self.redirects = {}
        self.page_size = 1000
        self.names_next = True
        self.at_once = self.most_at_once = 0
        self.delay_s = 0.0
        self.lock = threading.Condition()
        self.port = None

    @property
    def base(self):
        return f"http://127.0.0.1:{self.port}"

    def clear(self):
        """Remove all photos and recorded requests."""
        self.shots.clear()
        self.asked.clear()

    def photos_asked(self):
        """Return the numbers of requests by id of the photo."""
        return Counter({p.split("/")[2]: n for p, n in self.asked.items() if p.startswith("/photo/")})

    def answer(self, path, query, token):
        """Return the status and body of a response."""
        self.asked[path] += 1
        if self.failing.get(path):
            return self.failing[path].pop(0), b"no"
        if path in self.bodies:
            return 200, self.bodies[path]
        if path.startswith("/photo/"):
            shot = next(one for one in self.shots if one.id == path.split("/")[2])
            return 200, picture(shot.id, panorama=shot.panorama)
        if path == "/api/search":
            return 200, json.dumps(self._panoramax(query)).encode()
        if path == "/images":
            if token != f"OAuth {TOKEN}":
                return 401, b'{"error": {"message": "Invalid OAuth access token"}}'
            return 200, json.dumps(self._mapillary(query)).encode()
        return 404, b"none"

    def _inside(self, query):
        west, south, east, north = map(float, query["bbox"][0].split(","))
        return [s for s in self.shots if south <= s.lat <= north and west <= s.lon <= east]

    def _panoramax(self, query):
        shots = self._inside(query)
        start = int(query.get("page", ["0"])[0])
        size = min(int(query["limit"][0]), self.page_size)
        links = []
        if self.names_next and start + size < len(shots):
            sides = query["bbox"][0]
            href = f"/api/search?bbox={sides}&limit={query['limit'][0]}&page={start + size}"
            links.append({"rel": "next", "href": href})
        return {
            "type": "FeatureCollection",
            "features": [self._item(s) for s in shots[start : start + size]],
            "links": links,
        }

    def _item(self, shot):
        item = {
            "type": "Feature",
            "id": shot.id,
            "geometry": {"type": "Point", "coordinates": [shot.lon, shot.lat]},
            "properties": {
                "datetime": "2025-04-12T02:14:55+00:00",
                "license": "CC-BY-SA-4.0",
                "view:azimuth": shot.azimuth,
                "quality:horizontal_accuracy": 1.5,
                "original_file:size": 1_234_567,
                "pers:interior_orientation": {
                    "field_of_view": 360 if shot.panorama else 70,
                    "sensor_array_dimensions": [320, 160] if shot.panorama else [4096, 3072],
                },
            },
            "providers": [
                {"name": "Ana", "roles": ["producer"]},
                {"name": "The host", "roles": ["host"]},
            ],
            "assets": {
                "hd": {"href": f"{self.base}/photo/{shot.id}/hd"},
                "sd": {"href": f"{self.base}/photo/{shot.id}/sd"},
                "thumb": {"href": f"{self.base}/photo/{shot.id}/thumb"},
            },
        }
        item["properties"].update(shot.fields)
        return item

    def _mapillary(self, query):
        west, south, east, north = map(float, query["bbox"][0].split(","))
        assert (east - west) * (north - south) < 0.01
        shots = self._inside(query)[: min(int(query["limit"][0]), self.page_size)]
        return {"data": [self._image(s) for s in shots]}

    def _image(self, shot):
        return {
            "id": shot.id,
            "geometry": {"type": "Point", "coordinates": [0.0, 0.0]},
            "computed_geometry": {"type": "Point", "coordinates": [shot.lon, shot.lat]},
            "compass_angle": 1.0,
            "computed_compass_angle": shot.azimuth,
            "captured_at": 1_744_424_095_000,
            "thumb_2048_url": f"{self.base}/photo/{shot.id}/2048",
            "thumb_original_url": f"{self.base}/photo/{shot.id}/original",
            "is_pano": shot.panorama,
            "camera_type": "spherical" if shot.panorama else "perspective",
            "camera_parameters": [0.5, 0.0, 0.0],
            "width": 4000,
            "height": 3000,
            "creator": {"username": "ben", "id": "7"},
            **shot.fields,
        }


@contextmanager
def street(*shots):
    """Run a server during the block."""
    service = StreetServer(shots)

    class Handler(QuietHandler, BaseHTTPRequestHandler):
        def do_GET(self):
            parts = urlsplit(self.path)
            query = parse_qs(parts.query)
            token = self.headers["Authorization"]
            with service.lock:
                service.at_once += 1
                service.most_at_once = max(service.most_at_once, service.at_once)
                service.lock.notify_all()
                # others may come in meanwhile
                service.lock.wait_for(lambda: service.at_once > 2, timeout=service.delay_s)
                service.agents.add(self.headers["User-Agent"])
                service.tokens[parts.path, token] += 1
                service.queries.append((parts.path, query))
                status, body = service.answer(parts.path, query, token)
                service.at_once -= 1
            if parts.path in service.redirects:
                status, body = 302, b""
            self.send_response(status)
            if status == 302:
                self.send_header("Location", service.redirects[parts.path])
            if status in (429, 503) and service.retry_after is not None:
                self.send_header("Retry-After", service.retry_after)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body[: len(body) // 2] if parts.path in service.cut else body)
            if parts.path in service.cut:
                self.close_connection = True

    with running(Handler) as service.port:
        yield service
