"""The reader and writer of `map.json`."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, PhotoSource, Placement, SatelliteImage, UnplacedPhoto
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import MapJsonError
from webapp.files.maps.map_json import MapJson, format_map_json, parse_map_json

GOOD: dict[str, Any] = {
    "format": "experience-map",
    "version": 1,
    "revision": 7,
    "next_id": 12,
    "georeference": {
        "plane": "EPSG:32635",
        "plane_from_pixel": [[0.13, 0.0, 470683.0], [0.0, -0.13, 6696811.0], [0.0, 0.0, 1.0]],
        "method": "corners",
    },
    "placements": [{"name": "clusters", "experiences": [{"id": 0, "x_px": 20.5, "y_px": 18.25}]}],
    "experiences": [
        {
            "id": 0,
            "photo": "a.jpg",
            "x_px": 20.25,
            "y_px": 19,
            "heading_deg": 271.5,
            "fov_deg": 73.7,
            "gps_accuracy_m": 4.0,
            "taken_at": "2026-04-30T14:05:00+02:00",
            "name": "IMG 1.JPG",
            "blurred": [{"x": 0.1, "y": 0.2, "width": 0.3, "height": 0.4}],
            "source": {
                "service": "Street",
                "id": "s-1",
                "licence": "CC BY 4.0",
                "url": "https://a.example/s",
            },
            "panorama": {"masked": [{"x": 0.0, "y": 0.75, "width": 1.0, "height": 0.25}]},
        },
        {"id": 1, "photo": "b.jpg", "heading_deg": None},
    ],
    "title": "Park",
    "unplaced": [{"id": 2, "photo": "c.jpg", "heading_deg": 3.0}],
}


def changed(path: list[str | int], value: object) -> bytes:
    """Return GOOD with a changed or additional value at a path."""
    top = json.loads(json.dumps(GOOD))
    inner = top
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    return json.dumps(top).encode()


def test_everything_is_read() -> None:
    read = parse_map_json(json.dumps(GOOD).encode())
    assert (read.revision, read.next_id) == (7, 12)
    assert read.georeference is not None and read.georeference.plane_from_pixel[2] == 470683.0
    assert read.placements == {"clusters": {0: MapPixel(20.5, 18.25)}}
    assert read.experiences[0].position == MapPixel(20.25, 19.0)
    assert read.experiences[0].taken_at == "2026-04-30T14:05:00+02:00"
    assert (read.experiences[0].name, read.experiences[0].blurred) == ("IMG 1.JPG", ((0.1, 0.2, 0.3, 0.4),))
    source = PhotoSource("Street", "s-1", "CC BY 4.0", url="https://a.example/s")
    assert read.experiences[0].source == source
    assert read.experiences[0].panorama == Panorama(((0.0, 0.75, 1.0, 0.25),))
    assert read.experiences[1].panorama is None
    assert read.experiences[1].heading_deg is None and read.experiences[1].position is None
    assert read.title == "Park"
    assert read.unplaced == {2: UnplacedPhoto(2, "c.jpg", heading_deg=3.0)}


def test_only_format_and_version_are_needed() -> None:
    assert parse_map_json(b'\xef\xbb\xbf{"format": "experience-map", "version": 1}') == MapJson()


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (["format"], "other", r"\$\.format must be"),
        (["version"], 2, r"\$\.version must be 1"),
        (["version"], None, r"\$\.version is missing"),
        (["revision"], -1, r"\$\.revision is not from 0"),
        (["next_id"], 1.5, r"\$\.next_id must be a whole number"),
        (["next_id"], True, r"\$\.next_id must be a whole number, not true or false"),
        (["surprise"], 1, r"\$ has an unknown field 'surprise'"),
        (["georeference"], [], r"\$\.georeference must be an object, not a list"),
        (["georeference", "plane"], "EPSG:1", r"\$\.georeference cannot be used"),
        (["georeference", "plane"], "+init=/etc/passwd:s", r"\$\.georeference cannot be used"),
        (["georeference", "plane_from_pixel"], [[1, 0, 0]], "three rows of three"),
        (["georeference", "plane_from_pixel", 0, 1], "x", r"plane_from_pixel\[0\]\[1\] must be a number"),
        (["georeference", "plane_from_pixel"], [[0, 0, 0]] * 3, "inverse"),
        (["georeference", "method"], None, r"\$\.georeference\.method is missing"),
        (["placements", 0, "name"], "../up", r"\$\.placements\[0\]\.name .*not a valid name"),
        (["placements"], [{"name": "a"}, {"name": "a"}], r"\$\.placements\[1\] repeats"),
        (["placements", 0, "experiences", 0, "x_px"], None, r"experiences\[0\]\.x_px is missing"),
        (["experiences"], {}, r"\$\.experiences must be a list"),
        (["experiences", 1, "id"], 0, r"\$\.experiences\[1\] has the id 0"),
        (["experiences", 1, "id"], 2**31, r"experiences\[1\]\.id is not from"),
        (["experiences", 1, "photo"], 5, r"experiences\[1\]\.photo must be text"),
        (["experiences", 0, "x_px"], None, r"only one of x_px and y_px"),
        (["experiences", 0, "heading_deg"], 361, r"heading_deg is not from 0 to 360"),
        (["experiences", 0, "fov_deg"], 0, r"fov_deg is not above 0"),
        (["experiences", 0, "gps_accuracy_m"], -1, r"gps_accuracy_m is not 0 or more"),
        (["experiences", 0, "gps_accuracy_m"], 10**400, r"gps_accuracy_m is not 0 or more"),
        (["experiences", 0, "taken_at"], "yesterday", r"taken_at is not a time"),
        (["experiences", 0, "name"], 5, r"experiences\[0\]\.name must be text"),
        (["experiences", 0, "blurred", 0, "width"], 0.95, r"blurred\[0\] is not a box inside the photo"),
        (
            ["experiences", 0, "blurred"],
            [{"x": 0.1, "y": 0.2, "width": 0.3, "height": 0.4}] * 501,
            r"blurred has 501 boxes, more than 500",
        ),
        (["experiences", 0, "blurred", 0], [0, 0, 1, 1], r"blurred\[0\] must be an object"),
        (["experiences", 0, "panorama"], {"views": 6}, r"panorama has an unknown field 'views'"),
        (["experiences", 0, "panorama", "masked", 0, "y"], 0.9, r"masked\[0\] is not a box inside the photo"),
        (["experiences", 0, "source", "url"], "javascript:alert(1)", r"source\.url is not a web address"),
        (["experiences", 0, "source", "licence"], None, r"source\.licence is missing"),
        (["title"], 5, r"\$\.title must be text"),
        (["unplaced", 0, "x_px"], 5, r"unplaced\[0\] has an unknown field 'x_px'"),
        (["unplaced"], [{"id": 1, "photo": "a"}] * 2, r"unplaced\[1\] has the id 1"),
    ],
)
def test_schema_errors_name_the_field(path: list[str | int], value: object, words: str) -> None:
    with pytest.raises(MapJsonError, match=words) as caught:
        parse_map_json(changed(path, value), where="park/map.json")
    assert caught.value.where == "park/map.json"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "map.json:1:1: this is not JSON"),
        (b'{\n "format": }', "map.json:2:12: this is not JSON"),
        (b'{"format": "\xff"}', "offset 12 is not UTF-8"),
        (b'{"version": NaN}', "NaN is not a JSON number"),
        (b'{"version": 1, "version": 1}', "duplicate field 'version'"),
        (b'{"version": ' + b"9" * 5000 + b"}", "number too long"),
        (b"[" * 100_000, "nested too deep"),
        (b"[]", r"\$ must be an object"),
        (b"null", r"\$ must be an object|\$ is missing"),
    ],
)
def test_what_is_no_json_of_ours(data: bytes, words: str) -> None:
    with pytest.raises(MapJsonError, match=words):
        parse_map_json(data)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(sorted(GOOD)) | st.text(max_size=5), inner)
        ),
        max_leaves=8,
    )
)
def test_any_json_is_read_or_refused(value: object) -> None:
    top = {**GOOD, **value} if isinstance(value, dict) else {**GOOD, "experiences": value}
    try:
        parse_map_json(json.dumps(top).encode())
    except MapJsonError as error:
        assert str(error).startswith("map.json")


def test_written_is_read_and_canonical() -> None:
    georeference = Georeference("EPSG:4326", (1e-6, 0.0, 22.1, 0.0, -1e-6, 60.1, 0.0, 0.0, 1.0), "corners")
    experience = Experience(4, "č a.jpg", MapPixel(1.1, 2.0), heading_deg=0.0, taken_at="2026-01-01")
    placement = Placement("clusters", {4: MapPixel(3.5, 2.5)})
    map_ = Map(
        SatelliteImage("s.png", 9, 9), (experience,), georeference, (placement,), next_id=5, revision=2
    )
    data = format_map_json(map_)
    read = parse_map_json(data)
    assert read.georeference == georeference
    assert read.placements == {"clusters": {4: MapPixel(3.5, 2.5)}}
    assert read.experiences[4].position == MapPixel(1.1, 2.0) and read.experiences[4].heading_deg == 0.0
    assert data == format_map_json(map_) and data.endswith(b"}\n") and "č".encode() in data


@pytest.mark.parametrize("heading", [-1.0, float("nan"), float("inf")])
def test_what_the_reader_refuses_is_not_written(heading: float) -> None:
    map_ = Map(SatelliteImage("s.png", 9, 9), (Experience(0, "a.jpg", MapPixel(1, 1), heading_deg=heading),))
    with pytest.raises(MapJsonError):
        format_map_json(map_)
