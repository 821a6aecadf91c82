"""The files of a library map are updated after its records, whatever happens in between."""

import threading

import pytest

from webapp.core.geo.types import MapPixel
from webapp.errors import StorageError
from webapp.files.maps import folder
from webapp.store.library import open_library
from webapp.store.maps import edits, maps
from webapp.store.schema import Account, MapRecord, Photo
from webapp.tasks.maps import export


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def map_id(library):
    """A map with an image and three photos, none of them placed."""
    with library.database.write() as session:
        ana = Account(name="ana")
        session.add(ana)
        session.flush()
        record = maps.create(session, "Park", account_id=ana.id)
        for n in range(3):
            known = {"size_bytes": 1, "width": 4, "height": 3, "fov_deg": 60.0}
            photo = Photo(name=f"{n}.jpg", path=f"photos/{n}.jpg", sha256=str(n), **known)
            maps.add_photo(session, record, row=photo)
        image = {"satellite_path": "plan.png", "satellite_width": 100, "satellite_height": 80}
        edits.apply(session, record, changes={"map": image}, kind="satellite", account_id=ana.id)
    return record.id


def place(library, map_id, *, photo=0, x=10.0):
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        changes = {
            f"photo/{photo}": {"x_px": x, "y_px": 5.25},
            f"placed/clusters/{photo}": {"x_px": 1.0, "y_px": 2.0},
        }
        edits.apply(session, record, changes=changes, kind="place", account_id=1)


def on_disk(library):
    return folder.read_map(library.cfg("park"))


def test_placed_photos_and_everything_known_of_them(library, map_id):
    place(library, map_id)
    assert export.export_map(library, map_id)
    there = on_disk(library)
    assert [(e.id, e.photo, e.position, e.fov_deg) for e in there.experiences] == [
        (0, "photos/0.jpg", MapPixel(10.0, 5.25), 60.0)
    ]
    assert (there.revision, there.next_id, there.placements[0].positions) == (5, 3, {0: MapPixel(1.0, 2.0)})
    assert library.cfg("park").read_text() == "plan.png;100;80\n0;photos/0.jpg;10;5\n"


def test_without_an_image_nothing_is_written(library):
    with library.database.write() as session:
        record = maps.create(session, "Empty", account_id=session.merge(Account(id=9, name="x")).id)
    assert export.export_map(library, record.id)
    assert not library.cfg("empty").exists()


def test_an_edit_from_outside_is_left_alone(library, map_id):
    place(library, map_id)
    export.export_map(library, map_id)
    library.cfg("park").write_text("plan.png;100;80\n0;photos/0.jpg;77;5\n")
    place(library, map_id, x=20.0)
    assert not export.export_map(library, map_id)
    assert on_disk(library).experiences[0].position.x == 77.0
    assert export.export_map(library, map_id, overwrite=True)
    assert on_disk(library).experiences[0].position.x == 20.0


@pytest.mark.parametrize("stopped_before", ["the placements", "the .cfg", "nothing"])
def test_a_killed_writer_is_no_edit_from_outside(library, map_id, monkeypatch, stopped_before):
    place(library, map_id)
    export.export_map(library, map_id)
    place(library, map_id, x=30.0)

    class Killed(BaseException):
        pass

    def killed(path, *parts):
        if stopped_before == "the placements" or path.name == "map.cfg":
            raise Killed
        return written(path, *parts)

    written = folder.write_bytes
    if stopped_before != "nothing":
        monkeypatch.setattr(folder, "write_bytes", killed)
        with pytest.raises(Killed):
            export.export_map(library, map_id)
        monkeypatch.undo()
    assert export.export_map(library, map_id)
    assert on_disk(library).experiences[0].position.x == 30.0


@pytest.mark.parametrize(
    "change", [{"heading_deg": 40.0}, {"x_px": 30.0, "y_px": 5.25}], ids=["turn", "move"]
)
def test_what_a_killed_writer_has_not_written_is_known_to_be_late(library, map_id, monkeypatch, change):
    place(library, map_id)
    export.export_map(library, map_id)
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        edits.apply(session, record, changes={"photo/0": change}, kind="edit", account_id=1)

    class Killed(BaseException):
        pass

    def killed(_cfg, _map):
        raise Killed

    with monkeypatch.context() as patched, pytest.raises(Killed):
        patched.setattr(export, "write_map", killed)
        export.export_map(library, map_id)
    export.export_late_maps(library)
    there = on_disk(library).experiences[0]
    assert {"heading_deg": there.heading_deg, "x_px": there.position.x}.items() >= {
        name: value for name, value in change.items() if name != "y_px"
    }.items()


def test_many_at_once_end_with_the_newest(library, map_id):
    def one(n):
        place(library, map_id, photo=n % 3, x=float(n))
        export.export_map(library, map_id)

    threads = [threading.Thread(target=one, args=(n,)) for n in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        placed = {p.id: p.x_px for p in maps.photos(session, record)}
    assert on_disk(library).revision == record.revision == record.exported_revision
    assert {e.id: e.position.x for e in on_disk(library).experiences} == placed


def test_a_file_that_went_missing_is_written_again(library, map_id):
    place(library, map_id)
    export.export_map(library, map_id)
    library.cfg("park").unlink()
    assert export.export_map(library, map_id)
    assert len(on_disk(library).experiences) == 1


def test_nothing_is_written_where_the_library_is_not_mounted(library, map_id, tmp_path):
    place(library, map_id)
    (tmp_path / "library").rename(tmp_path / "elsewhere")
    (tmp_path / "library").mkdir()
    with pytest.raises(StorageError, match="library is missing"):
        export.export_map(library, map_id)
    assert list((tmp_path / "library").iterdir()) == []
    (tmp_path / "library").rmdir()
    (tmp_path / "elsewhere").rename(tmp_path / "library")
    assert export.export_map(library, map_id)
    assert on_disk(library).experiences
