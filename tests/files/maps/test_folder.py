"""A map and the files next to it."""

import json
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, PhotoSource, Placement, SatelliteImage
from webapp.errors import CfgError, MapError, MapJsonError
from webapp.files.maps.folder import json_path, photo_path, read_map, write_map

GEO = Georeference("EPSG:4326", (1e-6, 0.0, 22.1, 0.0, -1e-6, 60.1, 0.0, 0.0, 1.0), "corners")
POSITIONS = st.builds(MapPixel, st.floats(0, 400), st.floats(0, 300))


@st.composite
def full_maps(draw: st.DrawFn) -> Map:
    some = st.none() | st.floats(0, 360, exclude_min=True)
    ids = draw(st.lists(st.integers(0, 50), unique=True, max_size=4))
    photos = tuple(
        Experience(
            id,
            f"p/{id}.jpg",
            draw(POSITIONS),
            heading_deg=draw(some),
            fov_deg=draw(some),
            gps_accuracy_m=draw(some),
            by_gps=draw(st.booleans()),
            radius_px=draw(st.none() | st.floats(0, 500)),
            taken_at=draw(st.none() | st.datetimes().map(lambda time: time.isoformat())),
            source=draw(st.sampled_from([None, PhotoSource("Street", f"s-{id}", "CC BY 4.0", "Ana")])),
        )
        for id in ids
    )
    names = draw(st.lists(st.sampled_from(["clusters", "b-2", "třetí"]), unique=True))
    placements = tuple(
        Placement(name, {id: draw(POSITIONS) for id in ids if draw(st.booleans())}) for name in names
    )
    return Map(
        SatelliteImage("s.png", 400, 300),
        photos,
        georeference=draw(st.sampled_from([None, GEO])),
        placements=placements,
        next_id=max(ids, default=-1) + 1 + draw(st.integers(0, 3)),
        revision=draw(st.integers(0, 9)),
    )


def test_a_photo_that_was_moved_in_the_cfg_is_not_where_its_gps_has_it(tmp_path):
    e = Experience(0, "a.jpg", MapPixel(20.0, 30.0), gps_accuracy_m=4.0, by_gps=True)
    write_map(tmp_path / "map.cfg", Map(SatelliteImage("s.png", 400, 300), (e,), next_id=1))
    assert read_map(tmp_path / "map.cfg").experiences == (e,)
    (tmp_path / "map.cfg").write_text("s.png;400;300\n0;a.jpg;90;30\n")
    assert not read_map(tmp_path / "map.cfg").experiences[0].by_gps


def test_a_photo_that_was_moved_in_the_cfg_is_exact_again(tmp_path):
    e = Experience(0, "a.jpg", MapPixel(20.0, 30.0), gps_accuracy_m=4.0, radius_px=7.5)
    write_map(tmp_path / "map.cfg", Map(SatelliteImage("s.png", 400, 300), (e,), next_id=1))
    assert read_map(tmp_path / "map.cfg").experiences == (e,)
    (tmp_path / "map.cfg").write_text("s.png;400;300\n0;a.jpg;90;30\n")
    assert read_map(tmp_path / "map.cfg").experiences[0].radius_px is None


def test_files_of_0_7_mean_gps_where_they_say_how_exact_it_is(tmp_path):
    (tmp_path / "map.cfg").write_text("s.png;400;300\n0;a.jpg;90;30\n1;b.jpg;90;40\n")
    photos = [{"id": 0, "photo": "a.jpg", "gps_accuracy_m": 4.0}, {"id": 1, "photo": "b.jpg"}]
    (tmp_path / "map.json").write_text(
        json.dumps({"format": "experience-map", "version": 1, "experiences": photos})
    )
    assert [e.by_gps for e in read_map(tmp_path / "map.cfg").experiences] == [True, False]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A map of two photos with all side files."""
    map_ = Map(
        SatelliteImage("s.png", 400, 300),
        (
            Experience(0, "a.jpg", MapPixel(20.25, 30.5), heading_deg=90.0),
            Experience(1, "b.jpg", MapPixel(5.0, 6.0)),
        ),
        georeference=GEO,
        placements=(Placement("clusters", {0: MapPixel(100.5, 100.25), 1: MapPixel(7.0, 7.0)}),),
        next_id=9,
        revision=3,
    )
    write_map(tmp_path / "map.cfg", map_)
    return tmp_path


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(map_=full_maps())
def test_written_map_is_read_back(tmp_path_factory: pytest.TempPathFactory, map_: Map) -> None:
    path = tmp_path_factory.mktemp("map") / "map.cfg"
    write_map(path, map_)
    assert read_map(path) == map_
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    write_map(path, read_map(path))
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


def test_lone_cfg_is_a_map_and_stays_alone(tmp_path: Path) -> None:
    path = tmp_path / "park.cfg"
    path.write_bytes(b"s.png;10;10\n4;a.jpg;1;2\n")
    map_ = read_map(path)
    assert map_.next_id == 5 and map_.revision == 0 and map_.georeference is None
    write_map(path, map_)
    assert [file.name for file in tmp_path.iterdir()] == ["park.cfg"]


def test_json_of_another_cfg_has_its_name(tmp_path: Path) -> None:
    assert json_path(tmp_path / "map.cfg").name == "map.json"
    assert json_path(tmp_path / "park.cfg").name == "park.map.json"


def test_cfg_wins_after_an_edit_from_outside(folder: Path) -> None:
    path = folder / "map.cfg"
    assert path.read_bytes() == b"s.png;400;300\n0;a.jpg;20;31\n1;b.jpg;5;6\n"
    path.write_bytes(b"s.png;400;300\n0;a.jpg;21;31\n12;c.jpg;5;6\n")
    map_ = read_map(path)
    assert map_.experiences[0].position == MapPixel(21.0, 31.0)
    assert map_.experiences[0].heading_deg == 90.0
    assert map_.next_id == 13
    assert map_.placements[0].positions == {0: MapPixel(100.5, 100.25)}


def test_record_of_another_photo_does_not_count(folder: Path) -> None:
    path = folder / "map.cfg"
    path.write_bytes(b"s.png;400;300\n0;new.jpg;20;31\n")
    (folder / "clusters.cfg").write_bytes(b"s.png;400;300\n")
    only = read_map(path).experiences[0]
    assert only == Experience(0, "new.jpg", MapPixel(20.0, 31.0))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "map file not found"),
        (b"s.png;400;301\n", "a different satellite image"),
        (b"s.png;400;300\n0;other.jpg;1;1\n", "a different photo"),
        (b"s.png;400;300\n0;a.jpg;1\n", "clusters.cfg:2:10"),
    ],
)
def test_bad_placements(folder: Path, content: bytes | None, words: str) -> None:
    placement = folder / "clusters.cfg"
    placement.unlink()
    if content is not None:
        placement.write_bytes(content)
    with pytest.raises(MapError, match=words):
        read_map(folder / "map.cfg")


def test_other_cfg_in_the_folder_is_another_map(folder: Path) -> None:
    (folder / "other.cfg").write_bytes(b"s.png;400;300\n0;other.jpg;1;1\n")
    assert [placement.name for placement in read_map(folder / "map.cfg").placements] == ["clusters"]


def test_damaged_files_are_reported(folder: Path) -> None:
    (folder / "map.json").write_bytes(b"{")
    with pytest.raises(MapJsonError, match=r"map\.json:1:2"):
        read_map(folder / "map.cfg")
    (folder / "map.cfg").write_bytes(b"")
    with pytest.raises(CfgError, match=r"map\.cfg:1:1"):
        read_map(folder / "map.cfg")


def test_nothing_is_written_of_a_map_that_cannot_be(folder: Path) -> None:
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    map_ = read_map(folder / "map.cfg")
    for name in ("map", "a/b", "", "Clusters"):
        placements = (*map_.placements, Placement(name, {}))
        with pytest.raises(MapError):
            write_map(folder / "map.cfg", Map(map_.satellite, map_.experiences, placements=placements))
    with pytest.raises(MapError, match="which the map does not have"):
        write_map(folder / "map.cfg", Map(map_.satellite, (), placements=map_.placements))
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_revision_and_ids_are_in_the_json(folder: Path) -> None:
    content = json.loads((folder / "map.json").read_bytes())
    assert (content["revision"], content["next_id"]) == (3, 9)


@pytest.mark.parametrize("name", ["../a.jpg", "/etc/passwd", "C:\\a.jpg", "https://example.org/a.jpg"])
def test_photos_stay_in_the_folder(folder: Path, name: str) -> None:
    with pytest.raises(MapError):
        photo_path(folder / "map.cfg", name)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_links_stay_in_the_folder(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "x.jpg").write_bytes(b"")
    (folder / "real.jpg").write_bytes(b"")
    (folder / "inside.jpg").symlink_to(folder / "real.jpg")
    (folder / "file.jpg").symlink_to(elsewhere / "x.jpg")
    (folder / "photos").symlink_to(elsewhere)
    assert photo_path(folder / "map.cfg", "inside.jpg").is_file()
    for name in ("file.jpg", "photos/x.jpg"):
        with pytest.raises(MapError, match="points outside"):
            photo_path(folder / "map.cfg", name)
