"""An external edit of `map.cfg` is detected, shown, and adopted or overwritten: never lost."""

import json

import pytest

from webapp.errors import Conflict, MapError, UsageError
from webapp.settings import Settings
from webapp.store.maps import edits
from webapp.store.schema import MapRecord
from webapp.tasks.maps import export, outside_edit

SETTINGS = Settings()


@pytest.fixture
def map_id(adopt):
    return adopt()


@pytest.fixture
def write(library):
    def change(*lines):
        library.cfg("park").write_text("\n".join(["plan.png;400;200", *lines]) + "\n")

    return change


@pytest.fixture
def take(library, owner, map_id):
    def run():
        shown = outside_edit.show(library, map_id, settings=SETTINGS)
        return outside_edit.take(library, map_id, account_id=owner, settings=SETTINGS, sha256=shown["sha256"])

    return run


@pytest.fixture
def undo(library, owner, map_id):
    def run():
        with library.database.write() as session:
            step = edits.undo(session, session.get(MapRecord, map_id), account_id=owner)
        export.export_map(library, map_id)
        return step

    return run


SAME = ("0;photos/0.jpg;100;100", "1;photos/1.jpg;200;100", "2;photos/2.jpg;300;100")


def show(library, map_id):
    return outside_edit.show(library, map_id, settings=SETTINGS)


def test_our_own_file_is_no_edit_from_outside(library, map_id, edit):
    assert show(library, map_id) is None
    edit(map_id, {"photo/1": {"x_px": 5.0, "y_px": 6.0}})
    export.export_map(library, map_id)
    assert show(library, map_id) is None


def test_everything_that_differs_is_shown_and_nothing_is_changed(library, map_id, write, save_photo, rows):
    save_photo(library.map_folder("park") / "photos" / "new.jpg", 99)
    write("0;photos/0.jpg;7;8", SAME[2], "9;photos/new.jpg;1;2", "10;photos/none.jpg;1;2")
    before = library.cfg("park").read_bytes()
    shown = show(library, map_id)
    assert shown["moved"] == [{"id": 0, "name": "0.jpg", "from": [100, 100], "to": [7, 8]}]
    assert shown["added"] == [{"id": 9, "name": "new.jpg"}]
    assert shown["removed"] == [{"id": 1, "name": "1.jpg"}]
    assert shown["left_out"] == ["photos/none.jpg: file not found"]
    assert (shown["problem"], shown["kept"], shown["turned"]) == (None, [], [])
    assert not export.export_map(library, map_id)
    assert library.cfg("park").read_bytes() == before
    assert set(rows(map_id)) == {0, 1, 2}


def test_it_is_taken_as_one_edit_and_undone_as_one(
    library, map_id, write, take, undo, save_photo, rows, record
):
    save_photo(library.map_folder("park") / "photos" / "new.jpg", 99)
    write("0;photos/0.jpg;7;8", SAME[2], "9;photos/new.jpg;1;2")
    assert take().revision == 1
    found = rows(map_id)
    assert [(row.x_px, row.removed) for row in found.values()] == [
        (7, False),
        (200, True),
        (300, False),
        (1, False),
    ]
    assert (list(found), record(map_id).next_id, record(map_id).revision) == ([0, 1, 2, 9], 10, 1)
    assert show(library, map_id) is None
    assert library.cfg("park").read_text().splitlines()[1:] == [
        "0;photos/0.jpg;7;8",
        SAME[2],
        "9;photos/new.jpg;1;2",
    ]
    assert undo().clash is None
    assert library.cfg("park").read_text().splitlines()[1:] == list(SAME)


def test_what_is_moved_there_is_exact(map_id, write, take, undo, edit, library, rows):
    edit(map_id, {f"photo/{id}": {"x_px": 100.0, "y_px": 50.0, "radius_px": 7.5} for id in (0, 1)})
    export.export_map(library, map_id)
    write("0;photos/0.jpg;7;8", "1;photos/1.jpg;100;50", SAME[2])
    take()
    assert [row.radius_px for row in rows(map_id).values()] == [None, 7.5, None]
    undo()
    assert [row.radius_px for row in rows(map_id).values()] == [7.5, 7.5, None]


def test_other_words_for_the_same_are_no_edit(library, map_id, take, record):
    library.cfg("park").write_text("plan.png;400;200\r\n" + "\r\n".join(reversed(SAME)))
    shown = show(library, map_id)
    assert not any(shown[key] for key in ("moved", "added", "removed", "kept"))
    assert take().revision is None
    assert record(map_id).revision == 0
    assert show(library, map_id) is None
    assert b"\r\n" in library.cfg("park").read_bytes(), "the file stays as its writer likes it"


def test_sub_pixels_and_headings_survive_an_edit_of_other_lines(library, map_id, write, take, edit, rows):
    edit(map_id, {"photo/1": {"x_px": 50.25, "y_px": 60.5, "heading_deg": 12.5}})
    export.export_map(library, map_id)
    (library.map_folder("park") / "map.json").unlink()
    write("0;photos/0.jpg;7;8", "1;photos/1.jpg;50;61", SAME[2])
    take()
    row = rows(map_id)[1]
    assert (row.x_px, row.y_px, row.heading_deg) == (50.25, 60.5, 12.5)


def test_a_heading_in_map_json_is_taken(library, map_id, write, take, rows):
    write("0;photos/0.jpg;100;100", "1;photos/1.jpg;200;101", SAME[2])
    content = {"format": "experience-map", "version": 1}
    record = {"id": 0, "photo": "photos/0.jpg", "heading_deg": 90}
    (library.map_folder("park") / "map.json").write_text(json.dumps({**content, "experiences": [record]}))
    assert [photo["id"] for photo in show(library, map_id)["turned"]] == [0]
    take()
    assert rows(map_id)[0].heading_deg == 90


def test_what_was_changed_here_since_then_stays(library, map_id, write, take, edit, rows):
    write("0;photos/0.jpg;7;8", "1;photos/1.jpg;9;9")
    edit(map_id, {"photo/0": {"x_px": 55.0, "y_px": 66.0}, "photo/2": {"x_px": 77.0, "y_px": 66.0}})
    shown = show(library, map_id)
    assert [photo["id"] for photo in shown["kept"]] == [0, 2]
    assert [photo["id"] for photo in shown["moved"]] == [1]
    take()
    assert [row.x_px for row in rows(map_id).values()] == [55, 9, 77]
    export.export_map(library, map_id)
    assert library.cfg("park").read_text().splitlines()[1:] == [
        "0;photos/0.jpg;55;66",
        "1;photos/1.jpg;9;9",
        "2;photos/2.jpg;77;66",
    ]


def test_a_renamed_photo_stays_the_same_photo(library, map_id, write, take, rows):
    photos = library.map_folder("park") / "photos"
    (photos / "1.jpg").rename(photos / "pond.jpg")
    write(SAME[0], "1;photos/pond.jpg;200;100", SAME[2])
    take()
    assert {id: row.path for id, row in rows(map_id).items()}[1] == "photos/pond.jpg"
    assert len(rows(map_id)) == 3 and not rows(map_id)[1].removed


def test_an_id_of_another_photo_is_not_used_again(library, map_id, write, take, rows, save_photo):
    save_photo(library.map_folder("park") / "photos" / "new.jpg", 99)
    write(SAME[0], "1;photos/new.jpg;200;100", SAME[2])
    take()
    found = rows(map_id)
    assert (found[1].removed, found[3].path, found[3].removed) == (True, "photos/new.jpg", False)


def test_a_photo_at_two_places(map_id, write, take, rows):
    write(*SAME, "5;photos/1.jpg;1;2")
    take()
    found = rows(map_id)
    assert (found[5].path, found[5].x_px) == ("photos/1.jpg", 1)


def test_placements_are_taken(library, map_id, write, take, undo, edit, rows):
    edit(map_id, {"placed/rough/0": {"x_px": 1.0, "y_px": 1.0}, "placed/rough/1": {"x_px": 1.0, "y_px": 1.0}})
    export.export_map(library, map_id)
    write("0;photos/0.jpg;100;101", *SAME[1:])
    (library.map_folder("park") / "rough.cfg").write_text("plan.png;400;200\n0;photos/0.jpg;50;60\n")
    assert show(library, map_id)["placements"] == ["rough"]
    take()
    assert (
        library.map_folder("park") / "rough.cfg"
    ).read_text() == "plan.png;400;200\n0;photos/0.jpg;50;60\n"
    undo()
    assert len((library.map_folder("park") / "rough.cfg").read_text().splitlines()) == 3


def test_a_file_that_is_no_map_has_a_problem_and_changes_nothing(library, map_id, write, take, record):
    write("0;photos/0.jpg;7.5;8")
    problem = show(library, map_id)["problem"]
    assert problem.startswith("map.cfg:2:16:") and str(library.folder) not in problem
    with pytest.raises(MapError) as caught:
        take()
    assert str(library.folder) not in str(caught.value)
    assert record(map_id).revision == 0


def test_another_satellite_image_is_refused(library, map_id, take):
    library.cfg("park").write_text("other.png;400;200\n")
    assert "another satellite image" in show(library, map_id)["problem"]
    with pytest.raises(UsageError):
        take()


def test_discarded_the_file_is_ours_again(library, map_id, write):
    write("0;photos/0.jpg;7;8")
    outside_edit.discard(library, map_id, sha256=show(library, map_id)["sha256"])
    assert library.cfg("park").read_text().splitlines()[1:] == list(SAME)
    assert show(library, map_id) is None


def test_a_file_that_changed_again_is_neither_taken_nor_discarded(library, map_id, owner, write):
    write("0;photos/0.jpg;7;8")
    sha256 = show(library, map_id)["sha256"]
    write("0;photos/0.jpg;9;9")
    with pytest.raises(Conflict):
        outside_edit.discard(library, map_id, sha256=sha256)
    with pytest.raises(Conflict):
        outside_edit.take(library, map_id, account_id=owner, settings=SETTINGS, sha256=sha256)
    assert "9;9" in library.cfg("park").read_text()


class TestControlPoints:
    """`map.json` next to the changed file may have other control points."""

    @pytest.fixture
    def write_points(self, library):
        def change(*points):
            file = library.cfg("park").with_name("map.json")
            extras = json.loads(file.read_bytes()) | {"control_points": list(points)}
            file.write_text(json.dumps(extras))

        return change

    @pytest.fixture
    def there(self, record, map_id):
        return lambda: {point["name"]: point for point in record(map_id).control_points or ()}

    def test_they_are_taken_over_with_the_file_and_undone(
        self, library, map_id, edit, write, write_points, take, undo, there
    ):
        edit(map_id, {"point/gate": point(1.0), "point/well": point(2.0)}, kind="control-points")
        export.export_map(library, map_id)
        clicks = [{"id": 1, "x": 0.5, "y": 0.25}, {"id": 77, "x": 0.5, "y": 0.25}]
        write_points({"name": "gate", **point(9.0)}, {"name": "tree", **point(3.0), "photos": clicks})
        write("0;photos/0.jpg;7;8", *SAME[1:])
        assert show(library, map_id)["control_points"] == ["gate", "tree"]
        take()
        assert {name: found["x_px"] for name, found in there().items()} == {
            "gate": 9.0,
            "tree": 3.0,
            "well": 2.0,  # fields missing in the file are kept
        }
        assert there()["tree"]["photos"] == clicks[:1]
        undo()
        assert {name: found["x_px"] for name, found in there().items()} == {"gate": 1.0, "well": 2.0}

    def test_what_was_changed_here_since_the_file_was_written_stays(
        self, library, map_id, edit, write, write_points, take, there
    ):
        edit(map_id, {"point/gate": point(0.5)}, kind="control-points")
        export.export_map(library, map_id)
        write_points({"name": "gate", **point(9.0)})
        write("0;photos/0.jpg;7;8", *SAME[1:])
        edit(map_id, {"point/gate": point(1.0)}, kind="control-points")
        assert show(library, map_id)["control_points"] == []
        take()
        assert there()["gate"]["x_px"] == 1.0


def test_notes_are_taken_over_with_the_file_and_undone(
    library, map_id, edit, write, take, undo, record, rows
):
    """Notes of positions, of a placed photo, and of one in the tray; those missing in the file are kept."""
    gate, well = {"title": "Gate", **point(1.0)}, {"title": "Well", **point(2.0)}
    first = {"note/1": gate, "note/2": well, "photo/2": {"x_px": None, "y_px": None}}
    edit(map_id, first, kind="notes")
    export.export_map(library, map_id)
    file = library.cfg("park").with_name("map.json")
    extras = json.loads(file.read_bytes())
    extras["notes"] = [
        {"id": 1, **gate, "text": "closed at night", "photos": [1, 77]},
        {"id": 3, "title": "Tree", **point(3.0)},
    ]
    noted = [{"id": id, "photo": f"photos/{id}.jpg", "note": f"of {id}"} for id in range(3)]
    extras |= {"experiences": noted[:2], "unplaced": noted[2:]}
    file.write_text(json.dumps(extras))
    write("0;photos/0.jpg;7;8", SAME[1])
    shown = show(library, map_id)
    assert (shown["notes"], shown["turned"]) == (["0.jpg", "1.jpg", "Gate", "Tree", "2.jpg"], [])
    take()
    there = {note["id"]: note for note in record(map_id).notes}
    assert {id: note["title"] for id, note in there.items()} == {1: "Gate", 2: "Well", 3: "Tree"}
    assert (there[1]["text"], there[1]["photos"]) == ("closed at night", [1])
    assert {id: row.note for id, row in rows(map_id).items()} == {0: "of 0", 1: "of 1", 2: "of 2"}
    undo()
    assert [note["title"] for note in record(map_id).notes] == ["Gate", "Well"]
    assert {row.note for row in rows(map_id).values()} == {None}


def test_a_note_that_was_changed_here_since_the_file_was_written_stays(
    library, map_id, edit, write, take, record
):
    note = {"title": "Gate", **point(1.0)}
    edit(map_id, {"note/1": note}, kind="notes")
    export.export_map(library, map_id)
    file = library.cfg("park").with_name("map.json")
    extras = json.loads(file.read_bytes()) | {"notes": [{"id": 1, **note, "text": "theirs"}]}
    file.write_text(json.dumps(extras))
    write("0;photos/0.jpg;7;8", *SAME[1:])
    edit(map_id, {"note/1": note | {"text": "ours"}}, kind="notes")
    assert show(library, map_id)["notes"] == []
    take()
    assert record(map_id).notes[0]["text"] == "ours"


def point(x):
    return {"x_px": x, "y_px": 5.0, "photos": []}


def test_notes_and_control_points_keep_photos_that_were_removed(
    library, map_id, write, edit, record, take, undo
):
    note = {"title": "Gate", "photos": [0, 1, 2]}
    clicks = [{"id": id, "x": 0.5, "y": 0.25} for id in (0, 1, 2)]
    edit(map_id, {"note/1": note}, kind="notes")
    edit(map_id, {"point/gate": {"x_px": 2.0, "y_px": 3.5, "photos": clicks}}, kind="control-points")
    edit(map_id, {"photo/1": {"removed": True}})
    export.export_map(library, map_id)
    write("0;photos/0.jpg;7;8")  # without the photo removed in the library, and without another one
    shown = show(library, map_id)
    assert (shown["notes"], shown["control_points"]) == ([], [])
    take()
    assert record(map_id).notes == [{"id": 1, **note}]
    assert record(map_id).control_points[0]["photos"] == clicks
    undo()
    assert record(map_id).notes == [{"id": 1, **note}]
