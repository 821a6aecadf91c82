"""Random files and requests that an attacker or a broken client could send.

All are derived from the random generator that is passed in: the same seed gives the same bytes.
"""

from __future__ import annotations

import io
import json
import random
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

TEXTS = (
    "", " ", "ok", "x" * 5000, "../../etc/passwd", "..\\x", "a\0b", "%00", "\U0001f600", "\u202e", "-1",
    "nan", "1e400", "=HYPERLINK(1)", "<script>alert(1)</script>", "'; DROP TABLE map; --", "{{7*7}}",
    "+nadgrids=/dev/zero", "EPSG:4326",
)  # fmt: skip
NUMBERS = (0, -1, 1, 0.5, 2**31 - 1, 2**31, 2**63, -(2**63), 10**30, 1e200, -1e200, 1e-300, 5, 300)
HEADS = (
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff",
    b"II*\x00",
    b"PK\x03\x04",
    b"GIF89a",
    b"\x00\x00\x00\x18ftypheic",
)
_GPX = "http://www.topografix.com/GPX/1/1"
_FORMATS: Mapping[str, str] = {
    "JPEG": "jpg",
    "PNG": "png",
    "WEBP": "webp",
    "TIFF": "tif",
    "GIF": "gif",
    "BMP": "bmp",
}


_POST = b"POST /api/v1/maps/target/undo HTTP/1.1\r\nHost: here\r\nContent-Type: application/json\r\n"
_GET = b"GET /sign-in HTTP/1.1\r\nHost: here\r\n"
CONNECTIONS: tuple[tuple[bytes, ...], ...] = (
    (_POST + b"Content-Length: 12\r\n\r\n", b'{"seen": 12}' + _GET + b"\r\n"),
    (_POST + b"Content-Length: 9000\r\n\r\n{",),
    (_POST + b"Transfer-Encoding: chunked\r\n\r\n", b"5\r\n{", b"zz\r\n"),
    (_POST + b"Expect: 100-continue\r\nContent-Length: 12\r\n\r\n",),
    ((_GET + b"\r\n") * 20,),
    (_GET + b"Connection: close\r\n\r\n", b"more"),
    (_GET + b"X: " + b"x" * 100_000,),
    (_GET,),
    (b"\r\n\r\n\0\xff",),
    (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",),
    (b"",),
)
"""What clients send on a connection, piece by piece, that do not follow HTTP or do not read the answers."""


@dataclass(frozen=True, slots=True)
class Request:
    """A request with a body of `json`, of `raw` JSON, or of `files` and `data` of a form."""

    method: str
    path: str
    json: Any = None
    raw: bytes | None = None
    files: list[tuple[str, tuple[str, bytes]]] = field(default_factory=list)
    data: dict[str, str] = field(default_factory=dict)
    query: dict[str, str] = field(default_factory=dict)


def damaged(chance: random.Random, data: bytes) -> bytes:
    """Return the data with bytes changed, cut, repeated or inserted in a few places."""
    found = bytearray(data)
    for _ in range(chance.choice((0, 1, 1, 2, 8, 40))):
        if not found:
            break
        place = chance.randrange(len(found))
        size = chance.choice((1, 1, 2, 4, 64))
        match chance.randrange(5):
            case 0:
                found[place : place + size] = chance.randbytes(size)
            case 1:
                found[place : place + 4] = chance.choice((b"\xff" * 4, bytes(4), b"\x7f\xff\xff\xff"))
            case 2:
                del found[place : place + size]
            case 3:
                found[place:place] = found[place : place + 200] * chance.choice((1, 30))
            case _:
                del found[place:]
    return bytes(found)


def picture(chance: random.Random) -> tuple[str, bytes]:
    """Make a small image in a random format, unusual or damaged; return its name and content."""
    shape = chance.choice(((48, 64), (1, 1), (1, 4000), (4000, 1), (300, 400)))
    kind, suffix = chance.choice(tuple(_FORMATS.items()))
    values = np.random.default_rng(chance.randrange(2**32))
    file = io.BytesIO()
    if kind == "TIFF" and chance.random() < 0.5:
        wild = values.choice([0.0, 1.0, np.inf, -np.inf, np.nan, 3e38], shape).astype(np.float32)
        Image.fromarray(wild).save(file, kind)
    else:
        pixels = values.integers(0, 255, (*shape, 3)).astype(np.uint8)
        options = {"progressive": True} if kind == "JPEG" and chance.random() < 0.5 else {}
        Image.fromarray(pixels).save(file, kind, **options)
    data = file.getvalue()
    if kind == "JPEG" and chance.random() < 0.2:
        last = data[data.rfind(b"\xff\xda") : -2]
        data = data[:-2] + last * chance.choice((1, 100)) + data[-2:]
    if chance.random() < 0.1:
        data = chance.choice(HEADS) + chance.randbytes(chance.choice((0, 10, 5000)))
    if chance.random() < 0.1:
        data = _huge_png(chance)
    name = chance.choice((f"a.{suffix}", f"a.{suffix}", chance.choice(TEXTS)))
    return name, damaged(chance, data) if chance.random() < 0.6 else data


def cfg(chance: random.Random) -> bytes:
    """Make a map file, mostly with errors."""
    lines = [f"{_word(chance, 'plan.png')};{_word(chance, 400)};{_word(chance, 300)}"]
    for n in range(chance.choice((0, 1, 3, 3000))):
        lines.append(
            ";".join(str(_word(chance, usual)) for usual in (n, f"photos/{n}.jpg", n % 400, n % 300))
        )
    return "\n".join(lines).encode("utf-8", "replace")


def map_zip(chance: random.Random) -> bytes:
    """Make a zip of a map, mostly damaged."""
    file = io.BytesIO()
    plan = io.BytesIO()
    Image.new("RGB", (400, 300)).save(plan, "PNG")
    about = {
        "version": 1,
        "georeference": {"plane": chance.choice(TEXTS), "plane_from_pixel": 1, "method": "x"},
    }
    parts = {
        "map.cfg": cfg(chance),
        "plan.png": plan.getvalue(),
        "photos/0.jpg": picture(chance)[1],
        chance.choice(TEXTS).replace("\0", "") or "x.cfg": cfg(chance),
        "map.json": json.dumps(about).encode() if chance.random() < 0.5 else damaged(chance, b"{}"),
    }
    method = chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in parts.items():
            if name == "map.cfg" or chance.random() < 0.7:
                archive.writestr(zipfile.ZipInfo(name), data, compress_type=method)  # no timestamp
    return damaged(chance, file.getvalue()) if chance.random() < 0.6 else file.getvalue()


def track(chance: random.Random) -> tuple[str, bytes]:
    """Make a file with a track of a mission, unusual or damaged; return its name and content."""
    points = [
        (chance.choice(NUMBERS), chance.uniform(-100, 100), chance.uniform(-200, 200)) for _ in range(30)
    ]
    gpx = "".join(f'<trkpt lat="{lat}" lon="{lon}"><ele>{t}</ele></trkpt>' for t, lat, lon in points)
    forms = {
        "a.csv": "time,lat,lon,id\n"
        + "".join(f"{t},{lat},{lon},{chance.choice(TEXTS)!r}\n" for t, lat, lon in points),
        "a.gpx": f'<gpx version="1.1" xmlns="{_GPX}"><trk><trkseg>{gpx}</trkseg></trk></gpx>',
        "a.kml": '<!DOCTYPE x [<!ENTITY a "aa">]><kml><coordinates>&a;</coordinates></kml>',
        "a.tum": "".join(f"{t} {lat} {lon} 0 0 0 0 1\n" for t, lat, lon in points),
        "a.bag": "#ROSBAG V2.0\n",
        "a.nmea": "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n" * 5,
    }
    name, text = chance.choice(tuple(forms.items()))
    return name, damaged(chance, text.encode("utf-8", "replace"))


def api_request(chance: random.Random, document: Mapping[str, Any], *, known: Mapping[str, Any]) -> Request:
    """Make a request to a random operation of the API, by its OpenAPI schema, with unusual values.

    Args:
        document: The OpenAPI description.
        known: Existing values, by the names of path parameters.
    """
    path = chance.choice(sorted(document["paths"]))
    method = chance.choice(sorted(set(document["paths"][path]) & {"get", "post", "put", "patch", "delete"}))
    operation = document["paths"][path][method]
    parameters = [p for p in operation.get("parameters", ()) if p["in"] in ("path", "query")]
    address, query = path.removeprefix("/api/v1"), {}
    for parameter in parameters:
        name = parameter["name"]
        usual = known.get(name, 1) if chance.random() < 0.8 else chance.choice((*TEXTS, *NUMBERS))
        if parameter["in"] == "path":
            quoted = "".join(c if c.isalnum() or c in "-_" else f"%{ord(c) % 256:02x}" for c in str(usual))
            address = address.replace(f"{{{name}}}", quoted or "x")
        elif chance.random() < 0.7:
            query[name] = str(_value(chance, parameter.get("schema", {}), document))
    contents = operation.get("requestBody", {}).get("content", {})
    if "application/json" in contents:
        body = _value(chance, contents["application/json"]["schema"], document)
        return Request(method.upper(), address, json=body, query=query)
    files = [("file", picture(chance))] if contents else []
    return Request(method.upper(), address, files=files, query=query)


def _value(
    chance: random.Random, schema: Mapping[str, Any], document: Mapping[str, Any], *, depth: int = 0
) -> Any:
    """Make a value that fits a schema, or occasionally one that does not."""
    if chance.random() < 0.08 or depth > 6:
        return chance.choice((None, True, [], {}, *TEXTS, *NUMBERS))
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return _value(chance, document["components"]["schemas"][name], document, depth=depth + 1)
    if "enum" in schema:
        return chance.choice(schema["enum"])
    kind = schema.get("type", "string")
    kind = chance.choice(kind) if isinstance(kind, list) else kind
    match kind:
        case "object":
            fields = schema.get("properties", {})
            return {
                n: _value(chance, s, document, depth=depth + 1)
                for n, s in fields.items()
                if chance.random() < 0.8
            }
        case "array":
            items = schema.get("items", {})
            return [
                _value(chance, items, document, depth=depth + 1) for _ in range(chance.choice((0, 1, 2, 20)))
            ]
        case "integer" | "number":
            return chance.choice((*NUMBERS, 1, 2, 50.09, 14.4))
        case "boolean":
            return chance.random() < 0.5
        case _:
            return chance.choice(TEXTS)


def _word(chance: random.Random, usual: object) -> object:
    return usual if chance.random() < 0.97 else chance.choice((*TEXTS, *NUMBERS))


def _huge_png(chance: random.Random) -> bytes:
    """Make a PNG that declares a huge size, with hardly any data or as a decompression bomb."""
    width, height = chance.choice(((60_000, 60_000), (119_000_000, 1), (10_000, 10_000), (2**31 - 1, 1)))
    rows = min(width + 1, 200_000_000) * height if width * height < 2e8 and chance.random() < 0.5 else 10

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes((8, 0, 0, 0, 0))
    squeeze = zlib.compressobj(1)
    block = bytes(1 << 20)
    packed = b"".join(squeeze.compress(block) for _ in range(max(1, rows >> 20))) + squeeze.flush()
    return HEADS[0] + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
