"""Edits: undo and redo of every step, without losing the work of others."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import event

from webapp.errors import Conflict, NotFound
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere


@pytest.fixture
def ana(new_account):
    return new_account("ana")


@pytest.fixture
def ben(new_account):
    return new_account("ben")


@pytest.fixture
def do(library, ana, new_map):
    """Call a function of `edits` in a separate session, on a map with three photos."""
    map_id = new_map(ana, photos=3)

    def call(function, account=ana, **arguments):
        with library.database.write() as session:
            record = session.get(MapRecord, map_id)
            return function(session, record, account_id=account.id, **arguments)

    call.map_id = map_id
    return call


@pytest.fixture
def where(library, do):
    """Return x of the three photos."""

    def look():
        with library.database.read() as session:
            return [session.get(Photo, (do.map_id, n)).x_px for n in range(3)]

    return look


@pytest.fixture
def statements(library):
    """All executed statements."""
    sent = []
    event.listen(library.database.engine, "before_cursor_execute", lambda *args: sent.append(args[2]))
    return sent


def put(x, photo=0):
    return {"changes": {f"photo/{photo}": {"x_px": x, "y_px": 0.0}}, "kind": "place"}


def test_undo_and_redo_are_exact(do, where):
    do(edits.apply, **put(1.0))
    do(edits.apply, **put(2.0))
    do(edits.apply, **put(7.0, photo=1))
    assert where() == [2.0, 7.0, None]
    assert [do(edits.undo).clash for _ in range(3)] == [None] * 3
    assert where() == [None] * 3
    assert do(edits.undo) is None
    do(edits.redo)
    assert where() == [1.0, None, None]
    do(edits.redo)
    do(edits.redo)
    assert where() == [2.0, 7.0, None]
    assert do(edits.redo) is None


def test_a_new_edit_ends_what_could_be_redone(do, where):
    do(edits.apply, **put(1.0))
    do(edits.undo)
    do(edits.apply, **put(5.0, photo=2))
    assert do(edits.redo) is None
    assert where() == [None, None, 5.0]


def test_everyone_undoes_their_own(do, where, ben):
    do(edits.apply, **put(1.0))
    do(edits.apply, ben, **put(2.0, photo=1))
    do(edits.undo)
    assert where() == [None, 2.0, None]


def test_what_somebody_changed_since_is_not_undone(do, where, ben):
    do(edits.apply, **put(9.0, photo=2))
    do(edits.apply, **put(1.0))
    do(edits.apply, ben, **put(2.0))
    assert do(edits.undo).clash == "ben has changed the photo IMG_0.jpg in the meantime"
    assert where() == [2.0, None, 9.0]
    assert do(edits.undo).clash is None
    assert where() == [2.0, None, None]


def test_a_change_of_something_seen_too_early_is_a_conflict(library, do, where, ben):
    with library.database.read() as session:
        seen = session.get(MapRecord, do.map_id).revision
    do(edits.apply, ben, **put(2.0))
    do(edits.apply, **put(3.0, photo=1), seen=seen)
    both = {"photo/2": {"x_px": 1.0}, "photo/0": {"x_px": 1.0}}
    with pytest.raises(Conflict, match="ben has changed the photo IMG_0"):
        do(edits.apply, changes=both, kind="move", seen=seen)
    assert where() == [2.0, 3.0, None]


def test_nothing_changed_is_no_edit(library, do):
    do(edits.apply, **put(1.0))
    assert do(edits.apply, **put(1.0)) is None
    with library.database.read() as session:
        assert session.get(MapRecord, do.map_id).revision == 4  # three photos and one edit


def test_control_points_are_edits_of_their_own(library, do, ben):
    def point(x):
        return {"x_px": x, "y_px": 1.0, "photos": []}

    def there():
        with library.database.read() as session:
            points = session.get(MapRecord, do.map_id).control_points or []
            return {one["name"]: one["x_px"] for one in points}

    do(edits.apply, changes={"point/well": point(1.0)}, kind=edits.POINTS_KIND)
    do(edits.apply, ben, changes={"point/gate": point(2.0)}, kind=edits.POINTS_KIND)
    do(edits.apply, changes={"point/well": point(3.0)}, kind=edits.POINTS_KIND)
    assert do(edits.undo).clash is None
    assert there() == {"gate": 2.0, "well": 1.0}
    do(edits.apply, ben, changes={"point/well": None}, kind=edits.POINTS_KIND)
    assert there() == {"gate": 2.0}
    assert do(edits.undo).clash == "ben has changed the control point well in the meantime"
    do(edits.undo, ben)
    assert there() == {"gate": 2.0, "well": 1.0}


def test_other_placements_and_the_image_are_edits_too(library, do):
    do(edits.apply, changes={"placed/clusters/1": {"x_px": 4.0, "y_px": 5.0}}, kind="move")
    do(edits.apply, changes={"placed/clusters/1": None}, kind="move")
    do(edits.apply, changes={"map": {"satellite_path": "plan.png"}}, kind="satellite")

    def look():
        with library.database.read() as session:
            there = session.get(PlacedElsewhere, (do.map_id, "clusters", 1))
            return session.get(MapRecord, do.map_id).satellite_path, there and (there.x_px, there.y_px)

    assert look() == ("plan.png", None)
    do(edits.undo)
    assert look() == (None, None)
    do(edits.undo)
    assert look() == (None, (4.0, 5.0))
    do(edits.undo)
    assert look() == (None, None)


def test_unknown_photos_and_fields_are_refused(do):
    with pytest.raises(NotFound, match="no photo 77"):
        do(edits.apply, **put(1.0, photo=77))
    with pytest.raises(ValueError, match="sha256"):
        do(edits.apply, changes={"photo/0": {"sha256": "x"}}, kind="place")


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 5)), max_size=8))
def test_undoing_everything_gives_the_state_before(do, where, steps):
    before = where()
    made = [do(edits.apply, **put(float(x), photo=photo)) for photo, x in steps]
    after = where()
    count = sum(edit is not None for edit in made)
    for _ in range(count):
        do(edits.undo)
    assert where() == before
    for _ in range(count):
        do(edits.redo)
    assert where() == after
    for _ in range(count):
        do(edits.undo)


def test_a_photo_comes_once(library, do, new_photo):
    with library.database.write() as session:
        record = session.get(MapRecord, do.map_id)
        assert maps.add_photo(session, record, row=new_photo(1)).id == 1
        assert maps.add_photo(session, record, row=new_photo(50)).id == 3
        assert maps.counts(session, record) == (4, 0)
    do(edits.apply, changes={"photo/3": {"removed": True}}, kind="remove")
    with library.database.write() as session:
        record = session.get(MapRecord, do.map_id)
        assert maps.counts(session, record) == (3, 0)
        assert maps.add_photo(session, record, row=new_photo(50)).removed is False
        assert [p.id for p in maps.photos(session, record, since=record.revision - 1)] == [3]


def test_an_edit_of_many_photos_asks_as_often_as_one_of_few(library, ana, new_map, statements):
    map_id = new_map(ana, photos=60)

    def count(function, **arguments):
        statements.clear()
        with library.database.write() as session:
            assert function(session, session.get(MapRecord, map_id), account_id=ana.id, **arguments)
        return len(statements)

    def move(photos):
        return {"changes": {f"photo/{n}": {"x_px": 1.0, "y_px": 2.0} for n in photos}, "kind": "move"}

    few = count(edits.apply, **move(range(2))), count(edits.undo), count(edits.redo)
    many = count(edits.apply, **move(range(5, 60))), count(edits.undo), count(edits.redo)
    assert few == many


def test_what_undo_would_do_is_known_without_reading_the_edit(do, statements, library, ana):
    do(edits.apply, **put(1.0))
    do(edits.apply, **put(2.0, photo=1))
    do(edits.undo)
    statements.clear()
    with library.database.read() as session:
        steps = edits.next_steps(session, session.get(MapRecord, do.map_id), account_id=ana.id)
    assert steps == {"undo": edits.NextStep("place", 1), "redo": edits.NextStep("place", 1)}
    assert not any("edit.changes," in sent for sent in statements)


def test_next_steps_are_the_accounts_own_and_the_nearest(do, library, ana, ben):
    for x in (1.0, 2.0, 3.0):
        do(edits.apply, **put(x))
    do(edits.apply, account=ben, changes={"photo/1": {"removed": True}}, kind="remove")
    moved = {"changes": {"photo/0": {"x_px": 4.0, "y_px": 0.0}, "photo/2": {"x_px": 4.0, "y_px": 0.0}}}
    do(edits.apply, **moved, kind="move")
    do(edits.undo)
    do(edits.undo)
    with library.database.read() as session:
        record = session.get(MapRecord, do.map_id)
        steps = edits.next_steps(session, record, account_id=ana.id)
        assert steps == {"undo": edits.NextStep("place", 1), "redo": edits.NextStep("place", 1)}
        assert edits.next_steps(session, record, account_id=ben.id)["undo"] == edits.NextStep("remove", 1)
        assert edits.next_steps(session, record, account_id=0) == {"undo": None, "redo": None}
    do(edits.redo)
    with library.database.read() as session:
        steps = edits.next_steps(session, session.get(MapRecord, do.map_id), account_id=ana.id)
    assert steps["redo"] == edits.NextStep("move", 2)
    do(edits.apply, **put(9.0))
    with library.database.read() as session:
        steps = edits.next_steps(session, session.get(MapRecord, do.map_id), account_id=ana.id)
    assert steps["redo"] is None, "a new edit ends what could be redone"


def test_photos_that_the_session_holds_are_not_asked_for_again(do, statements, library):
    do(edits.apply, changes={"photo/2": {"removed": True}}, kind="remove")
    with library.database.read() as session:
        record = session.get(MapRecord, do.map_id)
        held = maps.photos_by_id(session, record, [0, 2])
        statements.clear()
        assert maps.photos_by_id(session, record, [0, 2]) == held and held[2].removed
        assert statements == []
        assert sorted(maps.photos_by_id(session, record, [0, 1, 2, 7])) == [0, 1, 2]
        assert len(statements) == 1
