"""A local server that speaks the part of Immich's API that is used, and can fail in chosen ways.

Written from the public OpenAPI document: https://api.immich.app
"""

import json
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import parse_qs, urlsplit

from tests.http_server import QuietHandler, running
from tests.street_server import picture

KEY = "immich-key-1"
ALBUM = "11111111-2222-4333-8444-555555555555"


@dataclass
class Shot:
    """An asset; `fields` replace those of its description."""

    id: str
    lat: float | None = None
    lon: float | None = None
    checksum: str = ""
    file: bytes = b""
    fields: dict = field(default_factory=dict)

    def __post_init__(self):
        self.checksum = self.checksum or f"sum-{self.id}="
        self.file = self.file or picture(self.id)


class ImmichServer:
    """Serves `shots` as one album.

    `asked` counts requests by method and path, `failing` has answers (status, headers) that a path gives
    first, `bodies` replaced content by path, `cut` paths whose content is truncated.
    """

    name, kind, key = "Immich", "immich", KEY
    wrong_key = 401

    def __init__(self, shots):
        self.shots = list(shots)
        self.albums = {ALBUM: "Round"}
        self.asked, self.failing, self.bodies, self.cut = Counter(), {}, {}, set()
        self.written = []
        self.port = None
        self.keys = set()

    LIST, ALBUMS, WRITE = "POST /api/search/metadata", "GET /api/albums", "PUT /api/assets"

    def preview_path(self, id):
        return f"GET /api/assets/{id}/thumbnail"

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def find(self, id):
        return next(shot for shot in self.shots if shot.id == id)

    def previews(self):
        """Return how often each preview was fetched, by id."""
        return {key.split("/")[3]: n for key, n in self.asked.items() if key.endswith("/thumbnail")}

    def is_signed(self, headers):
        self.keys.add(headers.get("x-api-key"))
        return headers.get("x-api-key") == self.key

    def answer(self, method, path, query, content):
        """Return the status and body of a response."""
        if (method, path) == ("GET", "/api/albums"):
            if query.get("shared") == ["true"]:
                return 200, []
            return 200, [
                {"id": id, "albumName": name, "assetCount": len(self.shots), "shared": False}
                for id, name in self.albums.items()
            ]
        if (method, path) == ("POST", "/api/search/metadata"):
            return 200, self._search(content)
        if (method, path) == ("PUT", "/api/assets"):
            for id in content["ids"]:
                shot = self.find(id)
                shot.lat, shot.lon = round(content["latitude"], 7), round(content["longitude"], 7)
                self.written.append((id, content["latitude"], content["longitude"]))
            return 204, b""
        if path.endswith("/thumbnail") and query.get("size") == ["preview"]:
            return 200, self.find(path.split("/")[3]).file
        return 404, {"message": "Not found"}

    def _search(self, content):
        known = {"albumIds", "type", "withExif", "order", "size", "page"}
        assert content.keys() <= known and 1 <= content["size"] <= 1000
        assert content["albumIds"] == [ALBUM] and content["type"] == "IMAGE"
        size = min(content["size"], 2)
        start = (content["page"] - 1) * size
        following = str(content["page"] + 1) if start + size < len(self.shots) else None
        items = [self._item(shot) for shot in self.shots[start : start + size]]
        return {"albums": {}, "assets": {"items": items, "nextPage": following, "count": len(items)}}

    def _item(self, shot):
        item = {
            "id": shot.id,
            "type": "IMAGE",
            "checksum": shot.checksum,
            "isTrashed": False,
            "originalFileName": f"IMG_{shot.id}.HEIC",
            "localDateTime": "2026-05-01T12:30:15.000Z",
            "exifInfo": {
                "dateTimeOriginal": "2026-05-01T10:30:15.000+00:00",
                "make": "Canon",
                "model": "EOS R6",
                "latitude": shot.lat,
                "longitude": shot.lon,
            },
        }
        return {**item, **shot.fields}


@contextmanager
def serving(server):
    """Run a stand-in of a photo library during the block."""

    class Handler(QuietHandler):
        def _do(self):
            parts = urlsplit(self.path)
            name = f"{self.command} {parts.path}"
            server.asked[name] += 1
            size = int(self.headers.get("Content-Length") or 0)
            content = json.loads(self.rfile.read(size)) if size else None
            headers = {}
            if server.failing.get(name):
                status, headers = server.failing[name].pop(0)
                body = b"no"
            elif not server.is_signed(self.headers):
                status, body = server.wrong_key, b'{"message": "Invalid API key"}'
            elif name in server.bodies:
                status, body = 200, server.bodies[name]
            else:
                status, body = server.answer(self.command, parts.path, parse_qs(parts.query), content)
            body = body if isinstance(body, bytes) else json.dumps(body).encode()
            self.send_response(status)
            for key, value in headers.items():
                self.send_header(key, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            if name in server.cut:
                body = body[: len(body) // 2]
                self.close_connection = True
            self.wfile.write(body)

        do_GET = do_POST = do_PUT = _do  # noqa: N815 - as the base class has them

    with running(Handler) as server.port:
        yield server
