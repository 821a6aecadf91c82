"""A change of a map and the job that it requires are one transaction."""

import sys

import pytest

from webapp.errors import NotFound
from webapp.store.maps import edits, maps
from webapp.store.operate import jobs
from webapp.store.schema import Photo
from webapp.tasks.maps import edit_map
from webapp.tasks.maps.edit_map import RequestedEdit


@pytest.fixture
def new_map(library, new_account):
    """Make a map with photos, all in the tray, and return its id."""
    owner = new_account("ana").id

    def make(photos):
        with library.database.write() as session:
            record = maps.create(session, "Park", account_id=owner)
            record.satellite_path, record.satellite_width, record.satellite_height = "plan.png", 100, 80
            for n in range(photos):
                known = {"size_bytes": 1, "width": 4, "height": 3}
                row = Photo(name=f"{n}.jpg", path=f"photos/{n}.jpg", sha256=str(n), **known)
                maps.add_photo(session, record, row=row)
            return record.id

    make.owner = owner
    return make


@pytest.fixture
def change(library, new_map):
    """Change photos of a map; return the kinds of the jobs queued then, and remove them."""

    def make(map_id, **fields):
        with library.changing(map_id) as change:
            changes = {"photo/0": fields}
            edits.apply(change.session, change.record, changes=changes, kind="test", account_id=new_map.owner)
        with library.database.write() as session:
            waiting = jobs.list_jobs(session, map_id=map_id)
            assert [job.id for job in waiting] == ([] if change.job is None else [change.job])
            for job in waiting:
                session.delete(job)
        return [job.kind for job in waiting]

    return make


def test_the_index_is_updated_where_photos_come_or_go(new_map, change):
    map_id = new_map(3)
    assert change(map_id, x_px=10.0, y_px=5.0) == ["index"]
    assert change(map_id, x_px=11.0, y_px=5.0) == []
    assert change(map_id, heading_deg=20.0) == []
    assert change(map_id, removed=True) == ["index"]
    assert change(map_id, x_px=None, y_px=None) == []
    assert change(map_id, removed=False) == []
    assert change(map_id, x_px=10.0, y_px=5.0) == ["index"]


def test_undo_is_such_a_change_too(library, new_map, change):
    map_id = new_map(3)
    change(map_id, x_px=10.0, y_px=5.0)
    with library.changing(map_id) as undone:
        edits.undo(undone.session, undone.record, account_id=new_map.owner)
    assert undone.job is not None


def test_what_fails_in_the_middle_changes_nothing(library, new_map):
    map_id = new_map(1)
    with pytest.raises(ZeroDivisionError), library.changing(map_id) as change:
        changes = {"photo/0": {"x_px": 1.0, "y_px": 1.0}}
        edits.apply(change.session, change.record, changes=changes, kind="test", account_id=new_map.owner)
        1 / 0  # noqa: B018
    with library.database.read() as session:
        assert jobs.list_jobs(session, map_id=map_id) == []
        assert session.get_one(Photo, (map_id, 0)).x_px is None


def test_a_map_that_is_gone(library):
    with pytest.raises(NotFound), library.changing(7):
        pass


def test_a_move_costs_the_same_on_every_map(library, new_map):
    """Counted in function calls, which do not depend on the load of the machine."""

    def calls_of_a_move(map_id, x):
        count = 0

        def note(_frame, event, _argument):
            nonlocal count
            count += event == "call"

        edit = RequestedEdit("move", {0: {"x_px": x, "y_px": 1.0}})
        sys.setprofile(note)
        try:
            edit_map.edit_map(library, map_id, edit=edit, account_id=new_map.owner)
        finally:
            sys.setprofile(None)
        return count

    few, many = new_map(10), new_map(400)
    for map_id in (few, many):
        calls_of_a_move(map_id, 1.0)
        calls_of_a_move(map_id, 2.0)
    assert calls_of_a_move(many, 3.0) < 1.2 * calls_of_a_move(few, 3.0)
