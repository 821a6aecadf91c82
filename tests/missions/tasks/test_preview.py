"""Thumbnails of missions: a few evenly spaced points, always the same ones."""

import numpy as np
import pytest
from sqlalchemy import event

from webapp.missions.store import missions
from webapp.missions.tasks import preview
from webapp.store.schema import Account


@pytest.fixture
def drawn(library, owner):
    """Draw all missions, the oldest first; return the pictures and the statements about objects."""

    def draw():
        asked = []

        def note(_connection, _cursor, statement, *_rest):
            if "mission_object.lat" in statement:
                asked.append(statement)

        event.listen(library.database.engine, "before_cursor_execute", note)
        try:
            with library.database.read() as session:
                entries = missions.list_missions(session, session.get_one(Account, owner))
                entries.sort(key=lambda entry: entry.mission.id)
                return preview.preview_missions(session, entries), asked
        finally:
            event.remove(library.database.engine, "before_cursor_execute", note)

    return draw


@pytest.mark.parametrize("count", [1, 99, 100, 101, 250, 1000])
def test_of_very_many_objects_some_are_shown_evenly(new_mission, drawn, library, count):
    mission = new_mission(0, objects=count)
    with library.database.read() as session:
        latlon = preview._objects(session, [mission])[mission]
    ids = sorted(f"o{number}" for number in range(count))
    places = [ids.index(f"o{round((lat - 50) * 1000)}") for lat in latlon[:, 0]]
    assert len(places) == min(count, 100) and places == sorted(places)
    gaps = np.diff([-1, *places])
    assert gaps.min() >= count // 100 if count > 100 else gaps.max() == 1
    assert gaps.max() <= -(-count // 100)
    (first,), (again,) = drawn()[0], drawn()[0]
    np.testing.assert_array_equal(first.dots, again.dots)


def test_objects_of_a_whole_list_are_read_together(new_mission, drawn, monkeypatch):
    for objects in (3, 0, 150, 7):
        new_mission(5, objects=objects)
    pictures, asked = drawn()
    assert [len(picture.dots) for picture in pictures] == [3, 0, 100, 7]
    assert [len(picture.line) for picture in pictures] == [5] * 4
    assert len(asked) == 1
    monkeypatch.setattr(preview, "_AT_ONCE", 3)
    assert [len(picture.dots) for picture in drawn()[0]] == [3, 0, 100, 7]


def test_a_mission_of_very_many_objects_shows_its_first_ones(new_mission, drawn, monkeypatch):
    monkeypatch.setattr(preview, "_MOST_COUNTED", 150)
    for objects in (150, 151):
        new_mission(0, objects=objects)
    pictures, asked = drawn()
    assert [len(picture.dots) for picture in pictures] == [100, 100]
    assert ["row_number" in statement for statement in asked] == [True, False], "the large one is not counted"


def test_a_mission_without_positions_has_no_picture(new_mission, drawn):
    new_mission(0, objects=0)
    assert drawn()[0] == [None]
