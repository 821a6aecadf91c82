"""Golden test of the facts of photos: files, API, shares, edits and exports stay byte for byte.

`RECORD_GOLDEN=1 pytest tests/web/maps/test_photo_facts.py` writes `photo_facts.jsonl` anew.
"""

import io
import json
import os
import re
import zipfile
from pathlib import Path

import pytest
from sqlalchemy import select

from tests.web.maps.images import png
from webapp.core.boxes import BlurBox
from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.core.mapmodel.model import Experience, Map, PhotoSource, Placement, SatelliteImage, UnplacedPhoto
from webapp.core.mapmodel.notes import MapNote
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import MapJsonError
from webapp.files.maps.folder import write_map
from webapp.files.maps.map_json import parse_map_json
from webapp.store.schema import Edit

GOLDEN = Path(__file__).with_name("photo_facts.jsonl")
EVERY_FACT = {
    "heading_deg": 271.5,
    "fov_deg": 360.0,
    "gps_accuracy_m": 4.5,
    "taken_at": "2026-05-31T14:05:00+02:00",
    "name": "By the gate.PNG",
    "blurred": (BlurBox(0.25, 0.25, 0.5, 0.5),),
    "source": PhotoSource(
        service="Panoramax", id="9f79", licence="CC BY-SA 4.0", author="Ana", url="https://a.b"
    ),
    "panorama": Panorama((BlurBox(0.0, 0.75, 1.0, 0.25),)),
    "note": "The gate\nwas #blue.",
}
SCALE = (1e-5, 0.0, 14.4, 0.0, -1e-5, 50.1, 0.0, 0.0, 1.0)
FULL = Map(
    satellite=SatelliteImage("s.png", 300, 200),
    experiences=(
        Experience(id=0, photo="a.png", position=MapPixel(20.25, 19.5), radius_px=7.5, floor=1, **EVERY_FACT),
        Experience(id=1, photo="b.png", position=MapPixel(40.0, 50.0)),
        Experience(
            id=2,
            photo="c.png",
            position=MapPixel(60.5, 70.5),
            by_gps=True,
            gps_accuracy_m=3.0,
            taken_at="2026-05-31",
        ),
    ),
    georeference=Georeference("EPSG:4326", SCALE, "corners"),
    placements=(
        Placement("clusters", {0: MapPixel(1.5, 1.5), 1: MapPixel(2.0, 3.0), 2: MapPixel(4.0, 4.0)}),
    ),
    next_id=7,
    revision=3,
    title="Golden",
    unplaced=(UnplacedPhoto(id=4, photo="t.png", **EVERY_FACT), UnplacedPhoto(id=5, photo="u.png")),
    control_points=(
        GroundControlPoint("gate", MapPixel(2.5, 7.0), (PhotoClick(0, 0.4, 0.6),), 0.05, 212.4),
        GroundControlPoint("lamp", None, ()),
    ),
    notes=(MapNote(1, "Bench", MapPixel(2.5, 7.0), "Since May.", (0,), 1), MapNote(2, "Gone", None)),
    floors=(Floor(0, "Ground floor", 0.0), Floor(1, "1st floor", 1.0, 4.5)),
)
EDITS = (
    {"kind": "turn", "changes": [{"id": 1, "heading_deg": -90.0}]},
    {"kind": "retime", "changes": [{"id": 0, "taken_at": "2026-06-01 10:00"}]},
    {"kind": "note", "changes": [{"id": 1, "note": " New. "}, {"id": 0, "note": ""}]},
    {"kind": "panorama", "changes": [{"id": 0, "panorama": None}, {"id": 4, "panorama": {"masked": []}}]},
    {"kind": "floor", "changes": [{"id": 1, "floor": 1}]},
    {"kind": "move", "changes": [{"id": 0, "x_px": 30.0, "y_px": 31.0}]},
    {"kind": "unplace", "changes": [{"id": 2, "x_px": None, "y_px": None}]},
)
SINGLE_EDITS = (
    (1, {"heading_deg": 10.0, "note": "Turned."}),
    (0, {"taken_at": None}),
    (4, {"panorama": None}),
    (1, {"floor": 0}),
    (1, {"heading_deg": None}),
    (4, {"x_px": 5.0, "y_px": 6.0, "heading_deg": 4.0, "taken_at": "2026-01-01"}),
)
REFUSED = (
    {"note": "a\x07"},
    {"taken_at": "noon"},
    {"floor": 9},
    {"panorama": {}},
    {"x_px": 1.0},
    {"name": "x"},
    {"note": "x" * 4001},
    {"taken_at": "2" * 41},
)
SHARES = ({}, {"photos": True}, {"photos": True, "originals": True}, {"notes": True})
BAD_FACTS = (
    {"heading_deg": 361},
    {"heading_deg": "n"},
    {"fov_deg": 0},
    {"gps_accuracy_m": -1},
    {"taken_at": "noon"},
    {"taken_at": 3},
    {"name": 3},
    {"blurred": [{"x": 0}]},
    {"blurred": [{"x": 0.5, "y": 0, "width": 1, "height": 1}]},
    {"source": {"service": "A", "id": "1", "licence": "L", "url": "ftp://x"}},
    {"panorama": []},
    {"note": "\u0000"},
    {"radius_px": -1},
    {"by_gps": 1},
    {"floor": 2},
    {"x_px": 1},
    {"weight": 1},
)


def zipped(folder):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    file.seek(0)
    return file


@pytest.fixture
def folder(tmp_path):
    """A folder with the map, whose unplaced photos are where an export has them."""
    there = tmp_path / "golden"
    (there / "unplaced").mkdir(parents=True)
    (there / "s.png").write_bytes(png((300, 200)).read())
    for n, name in enumerate(("a.png", "b.png", "c.png", "unplaced/t.png", "unplaced/u.png")):
        (there / name).write_bytes(png((80 + 2 * n, 40 + n), colour=(n, 90, 90)).read())
    write_map(there / "map.cfg", FULL)
    return there


def fixed(value):
    """Leave out what differs from run to run."""
    text = json.dumps(value, ensure_ascii=False)
    text = re.sub(r"\?v=[^\"]*|(?<=/shared/)[\w-]+", "", text)
    text = re.sub(r'"latlon_grid": \{[^}]*\}', '"latlon_grid": {}', text)
    return json.loads(re.sub(r'"(at|created_at|changed_at)": "[^"]*"', r'"\1": ""', text))


def edits_of(library):
    with library.database.read() as session:
        return [
            {"kind": e.kind, "changes": e.changes} for e in session.scalars(select(Edit).order_by(Edit.id))
        ]


def answers(client, library, folder):
    """Return what is compared, part by part."""
    made = client.post("/api/v1/maps/import", data={"file": (zipped(folder), "map.zip")}).json
    url = f"/api/v1/maps/{made['slug']}"
    parts = {"written": (folder / "map.json").read_text(), "imported": made, "state": client.get(url).json}
    parts["page"] = client.get(f"{url}/photos?limit=2").json
    parts |= {name: client.get(f"{url}/export.{name}").text for name in ("geojson", "kml", "csv")}
    parts["refused"] = [client.patch(f"{url}/experiences/1", json=fields).json for fields in REFUSED]
    parts["shares"] = []
    for wish in SHARES:
        token = client.post(f"{url}/shares", json=wish).json["url"].rsplit("/", 1)[1]
        parts["shares"].append(client.get(f"/api/v1/shared/{token}").json)
    copy = client.post(f"{url}/duplicate", json={"name": "Copy"}).json["slug"]
    parts["copy"] = client.get(f"/api/v1/maps/{copy}").json
    parts["edited"] = [client.patch(f"{url}/experiences", json=edit).json for edit in EDITS]
    parts["edited one"] = [
        client.patch(f"{url}/experiences/{id}", json=fields).json for id, fields in SINGLE_EDITS
    ]
    parts["edits"] = edits_of(library)
    with zipfile.ZipFile(io.BytesIO(client.get(f"{url}/export.zip").data)) as archive:
        parts["files"] = {name: archive.read(name).decode() for name in ("map.cfg", "map.json")}
    parts["undone"] = [client.post(f"{url}/undo", json={}).json for _ in (*EDITS, *SINGLE_EDITS)]
    parts["changes"] = client.get(f"{url}/changes?since=3").json
    parts["redone"] = [client.post(f"{url}/redo", json={}).json for _ in EDITS]
    return parts


def schemas(client):
    """Return the parts of the OpenAPI document that name the facts."""
    known = client.get("/api/v1/openapi.json").json["components"]["schemas"]
    return {name: known[name] for name in ("PhotoOut", "PhotoChange", "NumberedChange", "EditRequest")}


def problems(folder):
    """Return how invalid facts in `map.json` are rejected."""
    found = []
    for fields in BAD_FACTS:
        content = json.loads((folder / "map.json").read_text())
        content["experiences"][0] |= fields
        if "x_px" in fields:
            del content["experiences"][0]["y_px"]
        with pytest.raises(MapJsonError) as error:
            parse_map_json(json.dumps(content).encode())
        found.append({"fields": fields, "message": error.value.message, "hint": error.value.hint})
    return found


def test_facts_of_photos_are_as_recorded(client, library, folder):
    parts = fixed(answers(client, library, folder) | {"bad": problems(folder)}) | {"schemas": schemas(client)}
    lines = [json.dumps({name: value}, ensure_ascii=False) + "\n" for name, value in parts.items()]
    if os.environ.get("RECORD_GOLDEN"):
        GOLDEN.write_text("".join(lines), "utf-8")
    golden = GOLDEN.read_text("utf-8").splitlines(keepends=True)
    for line, wanted in zip(lines, golden, strict=True):
        assert json.loads(line) == json.loads(wanted)  # names what differs
        assert line == wanted  # also in the order of fields
