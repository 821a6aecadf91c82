"""PostgreSQL searches for similar photos with pgvector, with the same results as in memory."""

import logging

import numpy as np
import pytest
from sqlalchemy import text

from webapp.core.retrieval.engines.vlad import Codebook
from webapp.core.retrieval.global_descriptors import DIMENSIONS, Basis
from webapp.store.backends import photo_search
from webapp.store.database import Database
from webapp.store.maps import photo_vectors
from webapp.tasks.find.find_map import likeness

MAPS, PHOTOS = 12, 40

pytestmark = pytest.mark.usefixtures("postgresql_only")


@pytest.fixture
def search(library):
    return library.database.photo_search


@pytest.fixture
def basis_id(library):
    codebook = Codebook(np.zeros((1, 4), np.float32), np.zeros((1, 4), np.float32))
    with library.database.write() as session:
        return photo_vectors.add_basis(
            session, Basis(codebook, np.zeros((4, DIMENSIONS), np.float32)), photos=1
        )


@pytest.fixture
def maps(new_account, new_map):
    """Ids of some maps without photos."""
    ana = new_account("ana", is_owner=True)
    return [new_map(ana, photos=0, name=f"Map {number}") for number in range(MAPS)]


@pytest.fixture
def keep(library, basis_id):
    """Store and return vectors of a map, scattered around a random direction."""

    def run(map_id, count=PHOTOS):
        rng = np.random.default_rng([map_id, 0])
        direction = np.random.default_rng(map_id).normal(size=DIMENSIONS)
        rows = direction + rng.normal(size=(count, DIMENSIONS))
        rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float16)
        named = {f"{map_id:032x}{number:032x}": row for number, row in enumerate(rows)}
        with library.database.write() as session:
            photo_vectors.keep_vectors(session, map_id, basis_id=basis_id, vectors=named)
        return rows

    return run


def _query(map_id):
    direction = np.random.default_rng(map_id).normal(size=DIMENSIONS)
    return (direction / np.linalg.norm(direction)).astype(np.float32)


@pytest.mark.parametrize("few", [10**6, 4 * PHOTOS], ids=["all compared", "by the index"])
def test_maps_are_as_much_alike_as_in_memory(search, basis_id, maps, keep, few, monkeypatch):
    monkeypatch.setattr(photo_search, "_FEW", few)
    rows = {id: keep(id, count=2 if id == maps[4] else PHOTOS) for id in maps}
    search.refresh()
    for wanted in (maps[0], maps[4], maps[7]):
        query = _query(wanted)
        found = search.likeness(query, basis_id=basis_id, map_ids=maps)
        expected = {id: likeness(rows[id], query) for id in maps}
        assert max(found, key=found.get) == wanted
        compared = {id: value for id, value in found.items() if value >= -1.0}
        assert compared == pytest.approx({id: expected[id] for id in compared}, abs=2e-3)
        assert found.keys() == expected.keys() and len(compared) >= 4
        assert few == 4 * PHOTOS or compared == found


def test_maps_beyond_the_nearest_photos_come_last(search, basis_id, maps, keep, monkeypatch):
    monkeypatch.setattr(photo_search, "_FEW", 0)
    monkeypatch.setattr(photo_search, "NEAREST", PHOTOS // 2)
    for id in maps:
        keep(id)
    search.refresh()
    found = search.likeness(_query(maps[3]), basis_id=basis_id, map_ids=maps)
    assert found.keys() == {*maps} and max(found, key=found.get) == maps[3]
    assert sum(value < -1.0 for value in found.values()) == MAPS - 1, "its own photos are the nearest"


@pytest.mark.parametrize("few", [10**6, 0], ids=["all compared", "by the index"])
def test_photos_of_maps_that_one_may_not_see_are_not_looked_at(
    search, basis_id, maps, keep, few, monkeypatch
):
    monkeypatch.setattr(photo_search, "_FEW", few)
    monkeypatch.setattr(photo_search, "NEAREST", 10)
    for id in maps:
        keep(id)
    search.refresh()
    mine = maps[6:8]
    found = search.likeness(_query(maps[0]), basis_id=basis_id, map_ids=mine)
    assert found.keys() == {*mine} and max(found.values()) > -1.0


def test_what_changes_is_taken_over_and_what_is_gone_is_deleted(library, search, basis_id, maps, keep):
    keep(maps[0], count=5)
    keep(maps[1], count=5)
    assert search.stale() is None and search.is_behind(), "nothing is there yet"
    search.refresh()
    assert search.stale() == [] and not search.is_behind()
    before = _rows(library)
    keep(maps[0], count=8)
    assert search.stale() == [(maps[0], basis_id)] and search.is_behind()
    search.refresh()
    after = _rows(library)
    assert len(after) == 13 and before < after, "rows of photos that stay are not written again"
    keep(maps[0], count=3)
    with library.database.write() as session:
        session.execute(text("DELETE FROM map WHERE id = :id"), {"id": maps[1]})
    search.refresh()
    assert {(map_id, content) for map_id, content, _ in _rows(library)} == {
        (maps[0], bytes.fromhex(f"{maps[0]:032x}{number:032x}")) for number in range(3)
    }


def _rows(library):
    """Return the location of each row, which changes when it is rewritten."""
    with library.database.read() as session:
        return {
            (map_id, bytes(content), place)
            for map_id, content, place in session.execute(
                text("SELECT map_id, content, ctid::text FROM photo_vector")
            )
        }


def test_a_refresh_that_is_stopped_goes_on(search, maps, keep, basis_id):
    for id in maps:
        keep(id, count=4)
    calls = []

    def stop():
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search.refresh(check=stop)
    assert [id for id, _ in search.stale()] == maps[3:]
    found = search.likeness(_query(maps[0]), basis_id=basis_id, map_ids=maps)
    assert found.keys() == {*maps[:3]}, "the others are left to who compares in memory"
    search.refresh()
    assert search.stale() == []


def test_a_server_without_the_extension_is_said_once(search, maps, keep, basis_id, caplog, monkeypatch):
    keep(maps[0], count=4)
    monkeypatch.setattr(photo_search, "_ADD_EXTENSION", 'CREATE EXTENSION IF NOT EXISTS "no such extension"')
    with caplog.at_level(logging.INFO):
        search.refresh()
        search.refresh()
    (line,) = [record.getMessage() for record in caplog.records if "in memory" in record.getMessage()]
    assert "no such extension" in line
    assert search.stale() is None
    assert search.likeness(_query(maps[0]), basis_id=basis_id, map_ids=maps) == {}
    assert not search.is_behind(), "no job is queued that could do nothing"


def test_an_extension_that_is_too_old_is_left_alone(search, maps, keep, caplog, monkeypatch):
    keep(maps[0], count=4)
    monkeypatch.setattr(photo_search, "_OLDEST", (99, 0))
    with caplog.at_level(logging.INFO):
        search.refresh()
    assert "newer is needed" in caplog.text
    assert search.stale() is None and not search.is_behind()


def test_a_map_may_take_longer_than_a_statement(database_url, search, maps, keep):
    keep(maps[0])
    search.refresh()  # with the index, each insertion is slow
    keep(maps[0], count=1500)
    hasty = Database(f"{database_url}&options=-cstatement_timeout%3D50ms")
    try:
        hasty.photo_search.refresh()
        assert hasty.photo_search.stale() == []
    finally:
        hasty.close()


def test_the_index_is_made_when_the_first_photos_are_there(library, search, maps, keep):
    def has_index():
        with library.database.engine.connect() as connection:
            return connection.scalar(text("SELECT to_regclass('photo_vector_hnsw') IS NOT NULL"))

    search.refresh()
    assert not has_index()
    keep(maps[0])
    search.refresh()
    assert has_index()
