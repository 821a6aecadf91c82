"""`maps/FORMAT.md` documents all contents of map files, and all errors."""

import json
import re
from pathlib import Path

import pytest

from webapp.core.boxes import BlurBox
from webapp.core.geo.floors import Floor, FloorImage
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick, Tag
from webapp.core.mapmodel.findings import WARNINGS, Code
from webapp.core.mapmodel.model import Experience, Map, PhotoSource, Placement, SatelliteImage, UnplacedPhoto
from webapp.core.mapmodel.notes import MapNote
from webapp.core.mapmodel.panorama import Panorama
from webapp.files.maps.cfg import format_cfg, parse_cfg
from webapp.files.maps.map_json import format_map_json, parse_map_json

TEXT = (Path(__file__).parents[1] / "maps" / "FORMAT.md").read_text("utf-8")
FULL = Map(
    SatelliteImage("s.png", 9, 9),
    (
        Experience(
            0,
            "a.jpg",
            MapPixel(1.5, 1.5),
            heading_deg=1.0,
            fov_deg=1.0,
            gps_accuracy_m=1.0,
            taken_at="2026-01-01",
            name="A.JPG",
            blurred=(BlurBox(0, 0, 0.5, 0.5),),
            source=PhotoSource("Panoramax", "9f79a75d", "CC-BY-SA-4.0", "Ana"),
            panorama=Panorama((BlurBox(0, 0.75, 1.0, 0.25),)),
            by_gps=True,
            radius_px=7.5,
            note="It was blue.",
            floor=1,
        ),
    ),
    Georeference("EPSG:4326", (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), "corners"),
    (Placement("clusters", {0: MapPixel(1.5, 1.5)}),),
    next_id=1,
    title="A",
    description="The park.",
    unplaced=(UnplacedPhoto(2, "b.jpg", gps=LatLon(50.1, 14.4)),),
    control_points=(
        GroundControlPoint(
            "gate",
            MapPixel(2.5, 7.0),
            (PhotoClick(0, 0.4, 0.6),),
            0.05,
            212.4,
            Tag("36h11", 3, 150.0, "wall", 270.0),
        ),
    ),
    notes=(MapNote(1, "Bench", MapPixel(2.5, 7.0), "Since May.", (0,)),),
    floors=(
        Floor(0, "Ground floor", 0.0),
        Floor(1, "1st floor", 1.0, 4.5, FloorImage("b.png", 2, 2, (0.5, 0.0, 0.0, 0.0, 0.5, 0.0))),
    ),
)


def fields(value: object) -> set[str]:
    """Return the names of all fields of a JSON value."""
    if isinstance(value, dict):
        return set(value).union(*(fields(inner) for inner in value.values()))
    return set().union(*(fields(inner) for inner in value)) if isinstance(value, list) else set()


def example(begin: str) -> str:
    """Return the indented block of the text with this beginning."""
    block = TEXT[TEXT.index(f"    {begin}") :].split("\n\n")[0]
    return re.sub("^    ", "", block, flags=re.MULTILINE) + "\n"


@pytest.mark.parametrize("code", list(Code))
def test_every_finding_is_explained(code: Code) -> None:
    severity = "warning" if code in WARNINGS else "error"
    assert f"| `{code}` | {severity} |" in TEXT


def test_no_finding_is_invented() -> None:
    assert set(re.findall(r"^\| `([a-z0-9-]+)` \| (?:error|warning) \|", TEXT, re.MULTILINE)) == set(
        map(str, Code)
    )


@pytest.mark.parametrize("field", sorted(fields(json.loads(format_map_json(FULL)))))
def test_every_field_is_explained(field: str) -> None:
    rows = [line for line in TEXT.splitlines() if line.startswith("| `")]
    assert any(re.search(rf"[`.]{field}`", row) for row in rows)


def test_the_examples_are_valid() -> None:
    cfg = example("satellite.png;")
    assert format_cfg(parse_cfg(cfg).map).decode() == cfg
    data = example("{").encode()
    read = parse_map_json(data)
    assert read.next_id == 12 and read.experiences[0].photo == parse_cfg(cfg).map.experiences[0].photo
    assert fields(json.loads(data)) == fields(json.loads(format_map_json(FULL)))
