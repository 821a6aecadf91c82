"""Additional placements are created, replaced and deleted, and every step can be undone."""

import math

import pytest

from webapp.core.geo.types import MapPixel
from webapp.errors import MapError, NotFound, UsageError
from webapp.files.maps.folder import read_map
from webapp.store.maps import edits
from webapp.store.schema import MapRecord
from webapp.tasks.maps import edit_map, export


@pytest.fixture
def put(library, owner, adopt):
    map_id = adopt()

    def run(name, **wanted):
        edit_map.put_placement(library, map_id, name=name, account_id=owner, **wanted)
        export.export_map(library, map_id)
        return {p.name: dict(p.positions) for p in read_map(library.cfg("park")).placements}

    run.map_id = map_id
    return run


def test_from_the_places_of_the_map(put):
    assert put("copy") == {"copy": {0: (100, 100), 1: (200, 100), 2: (300, 100)}}


def test_gathered(put):
    assert set(put("clusters", clusters_px=120)["clusters"].values()) == {(200, 100)}


def test_replaced_as_a_whole_and_undone(put, library, owner):
    put("rough")
    assert put("rough", positions={1: MapPixel(5.5, 6)}) == {"rough": {1: (5.5, 6)}}
    with library.database.write() as session:
        edits.undo(session, session.get(MapRecord, put.map_id), account_id=owner)
    export.export_map(library, put.map_id)
    assert len(read_map(library.cfg("park")).placements[0].positions) == 3


def test_deleted(put, library, owner):
    put("rough")
    edit_map.delete_placement(library, put.map_id, name="rough", account_id=owner)
    export.export_map(library, put.map_id)
    assert read_map(library.cfg("park")).placements == ()
    assert not (library.map_folder("park") / "rough.cfg").exists()
    with pytest.raises(NotFound):
        edit_map.delete_placement(library, put.map_id, name="rough", account_id=owner)


@pytest.mark.parametrize("name", ["map", "MAP", "Rough"])
def test_names_whose_files_would_replace_others(put, name):
    put("rough")
    with pytest.raises(UsageError, match="replace another"):
        put(name)


@pytest.mark.parametrize("name", ["", "../map", "a/b", "a.b", "x" * 61])
def test_what_is_no_name(put, name):
    with pytest.raises(MapError):
        put(name)


@pytest.mark.parametrize(
    ("positions", "error"),
    [
        ({0: MapPixel(401, 0)}, UsageError),
        ({0: MapPixel(math.nan, 0)}, UsageError),
        ({7: MapPixel(1, 1)}, NotFound),
    ],
)
def test_positions_that_cannot_be(put, positions, error):
    with pytest.raises(error):
        put("rough", positions=positions)


def test_a_map_without_places(library, owner):
    with library.database.write() as session:
        record = MapRecord(slug="empty", name="Empty")
        session.add(record)
    with pytest.raises(UsageError, match="no photo is placed"):
        edit_map.put_placement(library, record.id, name="x", account_id=owner)
