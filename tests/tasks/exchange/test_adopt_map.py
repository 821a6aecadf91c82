"""A map folder becomes a map of the library without changes."""

import hashlib
import json

import pytest

from webapp.errors import CfgError, Conflict, MapError, UsageError
from webapp.files.maps.folder import read_map
from webapp.tasks.maps import adopt_map, export
from webapp.tasks.maps.library_map import as_map

WGS84 = {"plane": "EPSG:4326", "plane_from_pixel": [[1e-5, 0, 26.5], [0, -1e-5, 60.4], [0, 0, 1]]}


def with_json(cfg):
    """Add everything to a map that a folder can contain."""
    cfg.write_text("plan.png;400;200\n7;photos/2.jpg;30;40\n3;photos/0.jpg;10;20\n")
    placed = [{"id": 7, "x_px": 99.5, "y_px": 100.25}]
    content = {
        "format": "experience-map",
        "version": 1,
        "revision": 12,
        "next_id": 40,
        "georeference": {**WGS84, "method": "corners"},
        "placements": [{"name": "clusters", "experiences": placed}],
        "experiences": [
            {
                "id": 7,
                "photo": "photos/2.jpg",
                "x_px": 30.25,
                "y_px": 39.5,
                "heading_deg": 90.5,
                "fov_deg": 65.0,
                "by_gps": True,
            }
        ],
    }
    cfg.with_name("map.json").write_text(json.dumps(content))
    cfg.with_name("clusters.cfg").write_text("plan.png;400;200\n7;photos/2.jpg;100;100\n")


def test_everything_in_the_folder_is_in_the_database(adopt, library, record):
    map_id = adopt(change=with_json)
    found = record(map_id)
    assert (found.revision, found.next_id, found.exported_revision) == (12, 40, 12)
    with library.database.read() as session:
        map_ = as_map(session, session.merge(found, load=False))
    on_disk = read_map(library.cfg("park"))
    assert sorted(map_.experiences, key=lambda e: -e.id) == list(on_disk.experiences)
    assert (map_.georeference, map_.placements) == (on_disk.georeference, on_disk.placements)


def test_no_file_is_touched(adopt, library):
    before = {}

    def remember(cfg):
        with_json(cfg)
        before.update(
            {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in cfg.parent.rglob("*") if p.is_file()}
        )

    map_id = adopt(change=remember)
    assert export.export_map(library, map_id)
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before} == before


def test_the_next_edit_knows_the_file_as_ours(adopt, library, record):
    found = record(adopt())
    assert not export.changed_outside(found, library.cfg("park"))


def test_photos_that_cannot_be_read_keep_their_place(adopt, rows):
    def damage(cfg):
        (cfg.parent / "photos" / "0.jpg").unlink()
        (cfg.parent / "photos" / "1.jpg").write_bytes(b"no photo")

    found = rows(adopt(change=damage))
    assert [(row.x_px, row.width > 0) for row in found.values()] == [(100, False), (200, False), (300, True)]
    assert "file not found" in found[0].gps_problem
    assert "photos/1.jpg" in found[1].gps_problem


def test_unreadable_photos_are_reported(make_map, library):
    cfg = make_map(library.map_folder("park"), 2)
    (cfg.parent / "photos" / "1.jpg").unlink()
    contents = adopt_map.read(cfg, limits=adopt_map.Settings().photo, progress=adopt_map.Progress())
    assert contents.problems == ("photos/1.jpg: file not found",)


def test_one_photo_at_two_places(adopt, rows, library):
    def twice(cfg):
        cfg.write_text(cfg.read_text() + "9;photos/1.jpg;5;6\n")
        (cfg.parent / "photos" / "2.jpg").write_bytes((cfg.parent / "photos" / "0.jpg").read_bytes())

    found = rows(adopt(change=twice))
    assert len({row.sha256 for row in found.values()}) == 4
    content = (library.map_folder("park") / "photos" / "0.jpg").read_bytes()
    assert found[0].sha256 == hashlib.sha256(content).hexdigest()
    assert found[9].path == found[1].path


def test_a_map_is_adopted_once(adopt, library, owner):
    adopt()
    with pytest.raises(Conflict):
        adopt_map.adopt_map(library, "park", account_id=owner)


@pytest.mark.parametrize("slug", ["../outside", "a/b", ".library", "", "new", "a b"])
def test_a_name_that_is_no_address(library, owner, slug):
    with pytest.raises(UsageError, match="rename the folder"):
        adopt_map.adopt_map(library, slug, account_id=owner)


def test_a_folder_that_is_no_map(library, owner, make_map):
    with pytest.raises(MapError, match="map file not found"):
        adopt_map.adopt_map(library, "nothing", account_id=owner)
    make_map(library.map_folder("bad"), 1).write_text("plan.png;200;200\n0;photos/0.jpg;1.5;2\n")
    with pytest.raises(CfgError):
        adopt_map.adopt_map(library, "bad", account_id=owner)


def test_a_placement_with_the_name_of_the_map(library, owner, make_map):
    cfg = make_map(library.map_folder("park"), 1)
    content = {"format": "experience-map", "version": 1, "placements": [{"name": "map"}]}
    cfg.with_name("map.json").write_text(json.dumps(content))
    with pytest.raises(MapError, match="one file name"):
        adopt_map.adopt_map(library, "park", account_id=owner)
