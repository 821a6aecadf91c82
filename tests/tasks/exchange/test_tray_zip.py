"""Photos in the tray are exported with the map, and imported into the tray again."""

import io
import json
import zipfile
from pathlib import Path

import pytest

from webapp.errors import StorageError
from webapp.files.maps.folder import read_map
from webapp.settings import Settings
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere
from webapp.tasks.exchange import export_files, import_map
from webapp.tasks.maps import export


@pytest.fixture
def bring(library, owner, tmp_path):
    """Zip files and import them."""

    def run(files, *, into=None):
        path = tmp_path / "map.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in files.items():
                archive.writestr(name, content)
        if into is not None:
            return import_map.run_into(library, path, map_id=into, settings=Settings())
        return import_map.import_map(library, path, account_id=owner, name="Again", settings=Settings())

    return run


@pytest.fixture
def exported(library):
    """Export a map and return its files by name."""

    def run(map_id):
        with zipfile.ZipFile(
            io.BytesIO(b"".join(export_files.export_map_zip(library, map_id).pieces))
        ) as archive:
            names = archive.namelist()
            assert len(names) == len(set(names))
            return {name: archive.read(name) for name in names}

    return run


@pytest.fixture
def park(adopt, edit):
    """The id of a map with five photos, two of them in the tray and one removed."""
    map_id = adopt(photos=5)
    unplaced = {"x_px": None, "y_px": None}
    edit(map_id, {"photo/1": unplaced, "photo/3": unplaced, "photo/4": {**unplaced, "removed": True}})
    return map_id


def tray(rows):
    return {row.path: row.sha256 for row in rows.values() if row.x_px is None and not row.removed}


def test_the_tray_is_in_the_zip_and_nothing_that_was_removed(park, exported):
    files = exported(park)
    photos = {name for name in files if name.endswith(".jpg")}
    assert photos == {"photos/0.jpg", "photos/2.jpg", "unplaced/photos/1.jpg", "unplaced/photos/3.jpg"}
    assert b"/1.jpg" not in files["map.cfg"] and b"/3.jpg" not in files["map.cfg"]


def test_it_comes_back_into_the_tray(park, exported, bring, library, rows):
    files = exported(park)
    done = bring(files)
    assert (done.findings, done.left_out) == ((), ())
    assert tray(rows(done.map_id)) == tray(rows(park)) and len(tray(rows(park))) == 2
    folder = library.map_folder(done.slug)
    assert (folder / "photos" / "1.jpg").read_bytes() == files["unplaced/photos/1.jpg"]
    assert not (folder / "unplaced").exists()
    assert read_map(library.cfg(done.slug)).experiences == read_map(library.cfg("park")).experiences
    again = exported(done.map_id)
    assert {n: c for n, c in again.items() if n != "map.json"} == {
        n: c for n, c in files.items() if n != "map.json"
    }


def test_it_keeps_its_ids_and_so_the_order_of_the_photos(park, exported, bring, library, rows):
    files = exported(park)
    done = bring(files)
    assert {row.id: row.path for row in rows(done.map_id).values()} == {
        id: row.path for id, row in rows(park).items() if not row.removed
    }
    with library.database.read() as session:
        assert session.get_one(MapRecord, done.map_id).next_id == 5
    listed = json.loads(files["map.json"])
    listed["unplaced"].pop(0)
    later = bring({**files, "map.json": json.dumps(listed).encode()})
    assert {row.id for row in rows(later.map_id).values() if row.x_px is None} == {3, 5}


def test_what_is_known_of_each_photo_comes_back(park, exported, bring, library, owner, rows):
    known = {
        1: {
            "source": {"service": "Street", "id": "s-1", "licence": "CC BY 4.0"},
            "name": "výlet (2).JPG",
            "heading_deg": 12.5,
            "gps_accuracy_m": 30.0,
            "taken_at": "2026-05-01T12:00:00",
        },
        2: {
            "source": {"service": "Street", "id": "s-2", "licence": "CC0", "url": "https://a.example/s-2"},
            "name": "IMG_2.JPG",
            "heading_deg": 271.25,
            "fov_deg": 70.0,
            "gps_accuracy_m": 4.5,
            "x_px": 20.25,
            "y_px": 9.5,
        },
    }
    blurred = [{"x": 0.1, "y": 0.2, "width": 0.3, "height": 0.4}]
    with library.changing(park) as change:
        maps.rename(change.record, "Park of the old town")
        for id, fields in known.items():
            photo = maps.photo(change.session, change.record, id)
            for name, value in {**fields, "blurred": blurred}.items():
                setattr(photo, name, value)
        change.session.add(PlacedElsewhere(map_id=park, placement="clusters", photo_id=2, x_px=3.5, y_px=4.0))
    files = exported(park)
    done = bring(files)
    again = rows(done.map_id)
    for id, fields in known.items():
        assert {name: getattr(again[id], name) for name in fields} == fields
        assert again[id].blurred == blurred
    assert again[0].name == "0.jpg" and again[0].blurred is None
    once, twice = (json.loads(content["map.json"]) for content in (files, exported(done.map_id)))
    assert once.pop("title") == "Park of the old town" and twice.pop("title") == "Again"
    assert {**once, "revision": 0} == {**twice, "revision": 0}
    assert once["placements"][0]["experiences"] == [{"id": 2, "x_px": 3.5, "y_px": 4.0}]


def test_a_photo_of_it_can_be_placed(park, exported, bring, edit, library):
    done = bring(exported(park))
    edit(done.map_id, {"photo/3": {"x_px": 10.0, "y_px": 20.0}})
    assert export.export_map(library, done.map_id)
    assert [e.photo for e in read_map(library.cfg(done.slug)).experiences][-1] == "photos/3.jpg"


def test_filled_once_by_a_job_that_is_repeated(park, exported, bring, library, owner, rows):
    with library.database.write() as session:
        empty = maps.create(session, "Later", account_id=owner).id
    files = exported(park)
    for _ in range(2):
        bring(files, into=empty)
    assert len(rows(empty)) == 4 and tray(rows(empty)) == tray(rows(park))


def test_in_a_folder_made_by_hand(adopt, exported, bring, make_map, tmp_path, rows):
    files = exported(adopt())
    extra = (make_map(tmp_path / "more", 5).parent / "photos" / "4.jpg").read_bytes()
    more = {
        "unplaced/later.jpg": extra,
        "unplaced/same.jpg": extra,
        "unplaced/known.jpg": files["photos/0.jpg"],
    }
    done = bring({f"Park/{n}": c for n, c in {**files, **more, "unplaced/broken.jpg": b"no photo"}.items()})
    assert list(tray(rows(done.map_id))) == ["later.jpg"]
    broken, *known = done.left_out
    assert broken.startswith("unplaced/broken.jpg: ") and len(broken) > 25
    assert known == [f"unplaced/{n}.jpg: the map has this photo already" for n in ("known", "same")]
    assert done.findings == ()


@pytest.mark.parametrize(
    "name", ["map.cfg/x.jpg", "photos/0.jpg/x.jpg", "PHOTOS/0.jpg", "Photos/0.JPG/y/x.jpg", "Plan.PNG"]
)
def test_a_name_that_a_file_of_the_map_bars(adopt, exported, bring, make_map, tmp_path, rows, library, name):
    files = exported(adopt())
    extra = (make_map(tmp_path / "more", 5).parent / "photos" / "4.jpg").read_bytes()
    done = bring({**files, f"unplaced/{name}": extra})
    assert done.left_out == ()
    assert list(tray(rows(done.map_id))) == [f"unplaced/{name}"]
    assert (library.map_folder(done.slug) / "unplaced" / name).read_bytes() == extra
    again = exported(done.map_id)
    assert again[f"unplaced/unplaced/{name}"] == extra
    assert list(tray(rows(bring(again).map_id)).values()) == list(tray(rows(done.map_id)).values())


def test_a_photo_named_like_a_folder_of_the_map(adopt, exported, bring, make_map, tmp_path, rows):
    def rename(cfg):
        (cfg.parent / "photos").rename(cfg.parent / "a.jpg")
        cfg.write_text(cfg.read_text().replace("photos/", "a.jpg/"))

    files = exported(adopt(change=rename))
    extra = (make_map(tmp_path / "more", 5).parent / "photos" / "4.jpg").read_bytes()
    done = bring({**files, "unplaced/A.jpg": extra})
    assert list(tray(rows(done.map_id))) == ["unplaced/A.jpg"]


def test_a_disk_that_refuses_is_an_error_of_ours(park, exported, bring, monkeypatch):
    files = exported(park)
    rename = Path.rename

    def refused(self, target):
        if "tray" in self.parts:
            raise PermissionError(13, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(StorageError, match="Permission denied") as result:
        bring(files)
    assert result.value.where == "unplaced/photos/1.jpg"


def test_a_map_whose_own_folder_has_that_name(adopt, edit, exported, bring, rows):
    def rename(cfg):
        for name, folder in (("0.jpg", "unplaced/photos"), ("2.jpg", "unplaced")):
            (cfg.parent / folder).mkdir(parents=True, exist_ok=True)
            (cfg.parent / "photos" / name).rename(cfg.parent / folder / name)
        (cfg.parent / "photos" / "1.jpg").rename(cfg.parent / "photos" / "0.jpg")
        text = cfg.read_text().replace("photos/0.jpg", "unplaced/photos/0.jpg")
        cfg.write_text(text.replace("photos/2.jpg", "unplaced/2.jpg").replace("photos/1.jpg", "photos/0.jpg"))

    map_id = adopt(change=rename)
    edit(map_id, {"photo/1": {"x_px": None, "y_px": None}})
    files = exported(map_id)
    assert {"unplaced/photos/0.jpg", "unplaced/2.jpg", "unplaced/unplaced/photos/0.jpg"} <= set(files)
    done = bring(files)
    placed = {row.path for row in rows(done.map_id).values() if row.x_px is not None}
    assert placed == {"unplaced/photos/0.jpg", "unplaced/2.jpg"}
    assert set(tray(rows(done.map_id)).values()) == set(tray(rows(map_id)).values())


def test_a_position_that_no_file_of_the_zip_has_comes_back(park, exported, bring, library, rows):
    with library.changing(park) as change:
        row = change.session.get_one(Photo, (park, 1))
        row.gps_lat, row.gps_lon, row.gps_accuracy_m, row.gps_problem = 50.1, 14.4, 4.0, None
        row.file_notes = ["its position is from 1.xmp", "it is blurred"]
    files = exported(park)
    listed = {photo["id"]: photo for photo in json.loads(files["map.json"])["unplaced"]}
    assert (listed[1]["gps_lat"], listed[1]["gps_lon"]) == (50.1, 14.4) and "gps_lat" not in listed[3]
    done = bring(files)
    first, third = rows(done.map_id)[1], rows(done.map_id)[3]
    assert (first.gps_lat, first.gps_lon, first.gps_accuracy_m) == (50.1, 14.4, 4.0)
    assert first.gps_problem is None and first.file_notes == ["its position is from map.json"]
    assert third.gps_lat is None and third.gps_problem
    assert json.loads(exported(done.map_id)["map.json"])["unplaced"][0]["gps_lat"] == 50.1


XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="50,6.0N" '
    b'exif:GPSLongitude="14,24.0E"/></rdf:RDF></x:xmpmeta>'
)
GOOGLE = json.dumps({"geoData": {"latitude": 50.2, "longitude": 14.5}}).encode()


def test_files_beside_photos_in_a_zip_are_read(park, exported, bring, library, rows):
    """Both for placed photos and in the tray; they stay out of the list of what is left out."""
    beside = {
        "photos/0.xmp": XMP,
        "photos/2.jpg.supplemental-metadata.json": GOOGLE,
        "unplaced/photos/1.jpg.xmp": XMP,
        "unplaced/photos/3.jpg.json": GOOGLE,
    }
    done = bring({**exported(park), **beside})
    assert (done.findings, done.left_out) == ((), ())
    at = {id: (row.gps_lat, row.gps_lon) for id, row in rows(done.map_id).items()}
    assert at == {0: (50.1, 14.4), 1: (50.1, 14.4), 2: (50.2, 14.5), 3: (50.2, 14.5)}
    assert rows(done.map_id)[1].file_notes == ["its position is from 1.jpg.xmp"]
    assert {row.path for row in rows(done.map_id).values()} == {f"photos/{n}.jpg" for n in range(4)}
    assert [path.name for path in library.map_folder(done.slug).rglob("unplaced")] == []


def test_a_hostile_sidecar_is_left_out(park, exported, bring, rows):
    entity = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>' + XMP
    beside = {"unplaced/photos/1.xmp": entity, "unplaced/photos/3.jpg.json": b"[" * 100_000}
    done = bring({**exported(park), **beside})
    assert [rows(done.map_id)[id].gps_lat for id in (1, 3)] == [None, None]
    assert rows(done.map_id)[1].file_notes == ["1.xmp is damaged and was left out"]
