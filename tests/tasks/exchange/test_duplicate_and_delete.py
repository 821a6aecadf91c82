"""Copies are independent maps, and permanent deletion removes everything."""

import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.errors import Conflict, UsageError
from webapp.files.maps.folder import read_map
from webapp.files.photos import photo
from webapp.settings import Settings
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.exchange import duplicate_map
from webapp.tasks.maps import delete_map, export, findings


@pytest.fixture
def id_of(library):
    def find(slug):
        with library.database.read() as session:
            return session.query(MapRecord).where(MapRecord.slug == slug).one().id

    return find


def test_a_copy_has_everything(adopt, library, edit, owner, rows, id_of):
    map_id = adopt()
    edit(map_id, {"placed/clusters/1": {"x_px": 7.5, "y_px": 8.0}, "photo/0": {"x_px": None, "y_px": None}})
    edit(map_id, {"photo/2": {"removed": True}})
    edit(map_id, {"photo/1": {"x_px": 200.0, "y_px": 100.0, "radius_px": 7.5}})
    clicked = {"x_px": 2.0, "y_px": 3.5, "photos": [{"id": 1, "x": 0.5, "y": 0.25}]}
    edit(map_id, {"point/gate": clicked}, kind="control-points")
    with library.database.write() as session:
        session.get(MapRecord, map_id).uses_adopted = False
    export.export_map(library, map_id)
    slug = duplicate_map.duplicate_map(library, map_id, account_id=owner, name="Park copy")
    export.export_late_maps(library)
    first, second = read_map(library.cfg("park")), read_map(library.cfg(slug))
    assert (second.experiences, second.placements, second.next_id, second.control_points) == (
        first.experiences,
        first.placements,
        first.next_id,
        (GroundControlPoint("gate", MapPixel(2.0, 3.5), (PhotoClick(1, 0.5, 0.25),)),),
    )
    assert [e.radius_px for e in second.experiences] == [7.5]
    found = rows(id_of(slug))
    assert {id: row.x_px for id, row in found.items()} == {0: None, 1: 200}
    assert (library.map_folder(slug) / found[0].path).is_file()
    with library.database.read() as session:
        copy = session.get(MapRecord, id_of(slug))
        assert not export.changed_outside(copy, library.cfg(slug))
        assert copy.uses_adopted is False


def test_a_copy_has_no_files_of_what_its_map_has_not_any_more(adopt, library, edit, owner, id_of):
    map_id = adopt()
    folder = library.map_folder("park")
    (folder / "satellite-0123abcd.png").write_bytes(b"an earlier image")
    for id in (1, 2):
        photo.write_previews(photo.previews_folder(folder), str(id), previews={"thumb": b"small"})
    edit(map_id, {"photo/2": {"removed": True}})
    slug = duplicate_map.duplicate_map(library, map_id, account_id=owner, name="Copy")
    copied = library.map_folder(slug)
    assert not (copied / "satellite-0123abcd.png").exists()
    assert [photo.preview_path(copied, id, kind="thumb").exists() for id in (1, 2)] == [True, False]
    found = findings.list_findings(library, id_of(slug), settings=Settings())
    assert [problem for problem in found if problem.code == "orphan-photo"] == []


def test_a_copy_goes_its_own_way(adopt, library, edit, owner, id_of):
    map_id = adopt()
    slug = duplicate_map.duplicate_map(library, map_id, account_id=owner, name="Park")
    assert slug == "park-2"
    before = library.cfg("park").read_bytes()
    edit(id_of(slug), {"photo/1": {"x_px": 1.0, "y_px": 2.0}})
    export.export_map(library, id_of(slug))
    assert library.cfg("park").read_bytes() == before != library.cfg(slug).read_bytes()


def test_a_name_that_is_none_leaves_nothing(adopt, library, owner):
    map_id = adopt()
    with pytest.raises(UsageError):
        duplicate_map.duplicate_map(library, map_id, account_id=owner, name="\x07")
    assert sorted(p.name for p in library.folder.iterdir()) == [".library", "park"]


def test_only_the_bin_is_emptied(adopt, library):
    map_id = adopt()
    with pytest.raises(Conflict, match="only maps in the bin"):
        delete_map.delete_map(library, map_id)
    assert library.cfg("park").is_file()


def test_deleted_is_gone(adopt, library):
    map_id = adopt()
    with library.database.write() as session:
        maps.put_into_bin(session.get(MapRecord, map_id))
    delete_map.delete_map(library, map_id)
    assert not library.map_folder("park").exists()
    assert list((library.inner / "deleted").iterdir()) == []
    with library.database.read() as session:
        assert session.get(MapRecord, map_id) is None
        assert session.query(Photo).count() == 0


def test_what_is_computed_for_no_map_is_deleted_and_nothing_else(adopt, library):
    adopt()
    kept = [library.map_folder("park") / "derived", library.folder / "own" / "derived"]
    gone = library.folder / "gone" / "derived"
    for folder in (*kept, gone):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "manifest.json").write_text("{}")
    (library.folder / "own" / "notes.txt").write_text("mine")
    delete_map.delete_orphans(library)
    assert not gone.parent.exists()
    assert all((folder / "manifest.json").exists() for folder in kept)
    assert library.cfg("park").is_file()


@pytest.mark.parametrize("faster", ["before it is looked at", "before it is moved", "with files"])
def test_two_that_delete_what_is_computed_for_no_map_do_not_disturb_each_other(library, monkeypatch, faster):
    gone = library.folder / "gone" / "derived"
    gone.mkdir(parents=True)
    look, begun = delete_map._is_alone, []

    def look_with_another(folder):
        is_first = not begun
        begun.append(folder)
        if is_first and faster == "before it is looked at":
            delete_map.delete_orphans(library)
        found = look(folder)
        if is_first and faster == "before it is moved":
            delete_map.delete_orphans(library)
        if is_first and faster == "with files":
            (gone.parent / "map.cfg").write_text("plan.png;400;200\n")
        return found

    monkeypatch.setattr(delete_map, "_is_alone", look_with_another)
    delete_map.delete_orphans(library)
    assert len(begun) > 1
    assert gone.parent.exists() == (faster == "with files")
