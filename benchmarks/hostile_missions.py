"""GeoPackages, shapes drawn on missions and positions of phones that are costly, impossible or endless.

All are derived from the random generator that is passed in: the same seed gives the same content.
"""

from __future__ import annotations

import json
import math
import random
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.hostile_inputs import NUMBERS, TEXTS, Request, damaged
from tests.geopackages import POINTS, point, write_package

_ENDLESS = (
    "DROP TABLE points; CREATE VIEW points AS WITH RECURSIVE n(fid) AS "
    "(SELECT 1 UNION ALL SELECT fid + 1 FROM n) SELECT fid, {} AS geom, 'a.jpg' AS photo FROM n"
)
_BLOB = "UPDATE points SET data = zeroblob(8000000)"
_TRIGGER = (
    "CREATE TRIGGER t AFTER UPDATE ON points BEGIN INSERT INTO points(name) SELECT name FROM points; END"
)
_HOUR_S = 1_777_629_600


def package(chance: random.Random) -> tuple[str, bytes]:
    """Make a GeoPackage of a random one of `PACKAGES`, sometimes damaged; return its name and content."""
    data = _package(chance.choice(sorted(PACKAGES)))
    return "a.gpkg", damaged(chance, data) if chance.random() < 0.3 else data


def drawings_file(chance: random.Random) -> tuple[str, bytes]:
    """Make a file with many or odd shapes for a mission; return its name and content."""
    ring = _points(chance)
    many = chance.choice((1, max(1, 20_000 // len(ring))))
    if chance.random() < 0.5:
        coordinates = [[lon, lat] for lat, lon in ring]
        shape = {
            "type": chance.choice(("Polygon", "MultiPolygon", "LineString")),
            "coordinates": [coordinates],
        }
        feature = {"type": "Feature", "properties": {"name": chance.choice(TEXTS)}, "geometry": shape}
        return "a.geojson", json.dumps({"type": "FeatureCollection", "features": [feature] * many}).encode()
    text = " ".join(f"{lon},{lat}" for lat, lon in ring)
    boundary = f"<LinearRing><coordinates>{text}</coordinates></LinearRing>"
    outer = f"<Polygon>{'<outerBoundaryIs>' * 2}{boundary}{'</outerBoundaryIs>' * 2}</Polygon>"
    polygon = f"<Polygon><outerBoundaryIs>{boundary}</outerBoundaryIs></Polygon>"
    return (
        "a.kml",
        f"<kml>{f'<Placemark>{chance.choice((polygon, outer))}</Placemark>' * many}</kml>".encode(),
    )


def drawing(chance: random.Random, *, mission_id: int) -> Request:
    """Make a request that draws a shape, or asks how much of all areas is covered."""
    path = f"/missions/{mission_id}"
    if chance.random() < 0.3:
        return Request("GET", f"{path}/coverage")
    body: dict[str, Any] = {
        "kind": chance.choice(("area", "area", "line", "marker")),
        "name": chance.choice(TEXTS)[:120],
        "points": _points(chance),
    }
    if chance.random() < 0.5:
        body["radius_m"] = chance.choice((0.5, 200.0, *NUMBERS))
    return Request("POST", f"{path}/drawings", json=body)


def phone(chance: random.Random, *, token: str) -> Request:
    """Make a request of a phone with positions, in one of the forms that its link takes."""
    path, at = f"/phones/{token}", {"lat": 50 + chance.random(), "lon": chance.choice((14.4, *NUMBERS))}
    time = chance.choice((_HOUR_S + chance.randrange(3600), *NUMBERS))
    match chance.randrange(3):
        case 0:
            positions = [{"time": _HOUR_S + n, **at} for n in range(chance.choice((1, 500, 501, 4000)))]
            body = {"sender": "x" * chance.choice((8, 64)), "first": chance.choice((0, 1, *NUMBERS))}
            return Request("POST", f"{path}/positions", json={**body, "positions": positions})
        case 1:
            more = {chance.choice(TEXTS): chance.choice((*TEXTS, *NUMBERS))}
            return Request("POST", f"{path}/owntracks", json={"_type": "location", "tst": time, **at, **more})
        case _:
            query = {"time": str(time), "batt": chance.choice(TEXTS), **{n: str(v) for n, v in at.items()}}
            return Request("GET", f"{path}/track", query=query)


def _points(chance: random.Random) -> list[tuple[float, float]]:
    """Make the points of a shape, degrees north and east: a circle, a star, a comb, or no shape at all."""
    number = chance.choice((3, 60, 1000, 1001, 50_000))
    size = chance.choice((1e-9, 1e-3, 0.2, 90.0))
    turns = chance.choice((1, 1, number // 2 + 1))
    angles = [2 * math.pi * turns * n / number for n in range(number)]
    match chance.randrange(3):
        case 0:
            return [(50 + size * math.sin(a), 14.4 + size * math.cos(a)) for a in angles]
        case 1:
            return [(50 + size * (n % 2), 14.4 + size * n / number) for n in range(number)]
        case _:
            return [(chance.choice(NUMBERS), chance.uniform(-200, 200)) for _ in range(min(number, 1000))]


_GATE = (point(14.5, 50.25), "Gate", "a.jpg", 90.0, "")

PACKAGES: Mapping[str, Callable[[Path], Path]] = {
    "computed column": lambda path: write_package(
        path, [_GATE], columns=f"{POINTS}, more AS (zeroblob(1000000000))"
    ),
    "large blobs": lambda path: write_package(
        path, [_GATE], more="UPDATE points SET data = zeroblob(8000000)"
    ),
    "large comment": lambda path: write_package(
        path, [_GATE], more="UPDATE points SET comment = printf('%.*c', 2000000, 'x')"
    ),
    "endless view": lambda path: write_package(path, more=_ENDLESS.format("x'00'")),
    "endless photos": lambda path: write_package(path, more=_ENDLESS.format("zeroblob(100)")),
    "trigger": lambda path: write_package(
        path,
        [_GATE],
        more=_TRIGGER,
    ),
    "long geometry": lambda path: write_package(path, [(_GATE[0] + bytes(4_000_000), *_GATE[1:])]),
    "many rows": lambda path: write_package(path, [_GATE] * 60_000),
    "many layers": lambda path: write_package(
        path,
        [_GATE],
        more="".join(
            f"CREATE TABLE l{n} ({POINTS}); INSERT INTO gpkg_contents VALUES ('l{n}', 'features');"
            f"INSERT INTO gpkg_geometry_columns VALUES ('l{n}', 'geom', 4326);"
            for n in range(300)
        ),
    ),
}
"""Writes a GeoPackage, by what is odd in it."""


@cache
def _package(kind: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return PACKAGES[kind](Path(folder) / "a.gpkg").read_bytes()
