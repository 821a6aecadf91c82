"""Findings of the linter in a library map, and their fixes."""

import json

import cv2
import numpy as np
import piexif
import pytest

from webapp.errors import Conflict, NotFound, UsageError
from webapp.settings import Settings
from webapp.store.maps import edits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import export, findings

SETTINGS = Settings()
NORTH_UP = {
    "plane": "EPSG:4326",
    "plane_from_pixel": [[1e-5, 0, 26.5], [0, -1e-5, 60.4], [0, 0, 1]],
    "method": "corners",
}


@pytest.fixture
def found(library):
    def run(map_id):
        return findings.list_findings(library, map_id, settings=SETTINGS)

    return run


@pytest.fixture
def fix(library, owner):
    def run(map_id, what, ids=()):
        findings.fix_findings(library, map_id, fix=what, ids=ids, account_id=owner, settings=SETTINGS)

    return run


@pytest.fixture
def undo(library, owner):
    def run(map_id):
        with library.database.write() as session:
            assert edits.undo(session, session.get(MapRecord, map_id), account_id=owner).clash is None
        export.export_map(library, map_id)

    return run


def codes(problems):
    return [(problem.code, problem.ids, problem.fixes) for problem in problems]


def test_nothing_is_wrong_with_a_good_map(adopt, found):
    assert found(adopt()) == []


def test_missing_and_unreadable_photos_are_taken_out_and_come_back(adopt, found, fix, undo, library, rows):
    map_id = adopt(photos=4)
    folder = library.map_folder("park") / "photos"
    (folder / "1.jpg").unlink()
    (folder / "3.jpg").write_bytes(b"no photo")
    result = found(map_id)
    assert codes(result) == [("missing-photo", (1,), ("remove",)), ("unreadable-photo", (3,), ("remove",))]
    assert str(library.folder) not in "".join(problem.message for problem in result)
    fix(map_id, "remove", [1, 3])
    assert found(map_id) == []
    undo(map_id)
    assert len(found(map_id)) == 2 and not rows(map_id)[1].removed


def test_many_findings_of_one_kind_are_joined(adopt, found, library):
    map_id = adopt(photos=8)
    for path in (library.map_folder("park") / "photos").iterdir():
        path.unlink()
    (result,) = found(map_id)
    assert result.ids == tuple(range(8)) and "7 more" in result.message


def test_photos_in_the_folder_come_into_the_tray(adopt, found, fix, undo, library, rows, save_photo):
    map_id = adopt()
    folder = library.map_folder("park")
    save_photo(folder / "photos" / "extra.jpg", 77)
    (folder / "copy.jpg").write_bytes((folder / "photos" / "0.jpg").read_bytes())
    (folder / "photos" / "torn.jpg").write_bytes(b"x")
    (result,) = found(map_id)
    assert (result.code, result.fixes) == ("orphan-photo", ("adopt",))
    assert "extra.jpg" in result.message and "copy.jpg" not in result.message
    fix(map_id, "adopt")
    row = rows(map_id)[3]
    assert (row.path, row.x_px, row.removed, row.width) == ("photos/extra.jpg", None, False, 320)
    undo(map_id)
    assert rows(map_id)[3].removed
    assert "extra.jpg" not in found(map_id)[0].message


def test_unplaced_and_removed_photos_are_no_strangers(adopt, found, edit):
    map_id = adopt()
    edit(map_id, {"photo/0": {"x_px": None, "y_px": None}, "photo/1": {"removed": True}})
    assert found(map_id) == []


def test_a_former_satellite_image_is_known(adopt, found, edit, library, save_photo):
    map_id = adopt()
    save_photo(library.map_folder("park") / "new.png", 5)
    size = {"satellite_width": 320, "satellite_height": 240}
    edit(map_id, {"map": {"satellite_path": "new.png", **size}}, kind="satellite")
    assert found(map_id) == []


def test_the_true_size_of_the_image(adopt, found, fix, undo, library, rows, record):
    map_id = adopt()
    cv2.imwrite(str(library.map_folder("park") / "plan.png"), np.zeros((150, 250), np.uint8))
    (result,) = found(map_id)
    assert codes([result]) == [("image-size-differs", (), ("image-size",))]
    fix(map_id, "image-size")
    assert (record(map_id).satellite_width, record(map_id).satellite_height) == (250, 150)
    assert [row.x_px for row in rows(map_id).values()] == [100, 200, None]
    assert found(map_id) == []
    undo(map_id)
    assert [row.x_px for row in rows(map_id).values()] == [100, 200, 300]


def test_a_position_outside_goes_to_the_tray(adopt, found, fix, library, rows):
    map_id = adopt()
    with library.database.write() as session:
        session.get(Photo, (map_id, 2)).x_px = 500.0
    (result,) = found(map_id)
    assert codes([result]) == [("position-outside-image", (2,), ("to-tray",))]
    fix(map_id, "to-tray", result.ids)
    assert rows(map_id)[2].x_px is None and found(map_id) == []


def test_swapped_columns_are_swapped_back(adopt, found, fix, rows):
    def with_gps(cfg):
        for number, (x, y) in enumerate([(20, 190), (150, 10), (60, 180)]):
            degrees = lambda value: ((round(value * 1e7), 10**7), (0, 1), (0, 1))  # noqa: E731
            gps = {
                piexif.GPSIFD.GPSLatitude: degrees(60.4 - 1e-5 * x),
                piexif.GPSIFD.GPSLatitudeRef: b"N",
                piexif.GPSIFD.GPSLongitude: degrees(26.5 + 1e-5 * y),
                piexif.GPSIFD.GPSLongitudeRef: b"E",
            }
            piexif.insert(piexif.dump({"GPS": gps}), str(cfg.parent / "photos" / f"{number}.jpg"))
        cfg.write_text(
            "plan.png;400;200\n0;photos/0.jpg;20;190\n1;photos/1.jpg;150;10\n2;photos/2.jpg;60;180\n"
        )
        content = {"format": "experience-map", "version": 1, "next_id": 3, "georeference": NORTH_UP}
        cfg.with_name("map.json").write_text(json.dumps(content))

    map_id = adopt(change=with_gps)
    (result,) = found(map_id)
    assert codes([result]) == [("swapped-xy", (0, 1, 2), ("swap",))]
    fix(map_id, "swap", result.ids)
    assert [(row.x_px, row.y_px) for row in rows(map_id).values()] == [(190, 20), (10, 150), (180, 60)]
    assert found(map_id) == []


def test_swapping_never_leads_outside(adopt, fix, rows):
    map_id = adopt()
    with pytest.raises(UsageError, match="outside the image"):
        fix(map_id, "swap", [0, 2])
    assert rows(map_id)[0].x_px == 100


def test_a_photo_named_twice(adopt, found, fix):
    map_id = adopt(change=lambda cfg: cfg.write_text(cfg.read_text() + "9;photos/1.jpg;5;6\n"))
    (result,) = found(map_id)
    assert codes([result]) == [("duplicate-photo", (9,), ("remove",))]
    fix(map_id, "remove", [9])
    assert found(map_id) == []


@pytest.mark.parametrize(("take", "x"), [("outside-take", 7), ("outside-discard", 100)])
def test_an_edit_from_outside_is_a_finding_with_two_buttons(adopt, found, fix, library, rows, take, x):
    map_id = adopt()
    text = library.cfg("park").read_text()
    library.cfg("park").write_text(text.replace("100;100", "7;8"))
    (result,) = found(map_id)
    assert codes([result]) == [("outside-edit", (0,), ("outside-take", "outside-discard"))]
    assert "1 moved" in result.message
    fix(map_id, take)
    assert rows(map_id)[0].x_px == x and found(map_id) == []
    with pytest.raises(Conflict):
        fix(map_id, take)


def test_what_cannot_be_taken_has_one_button(adopt, found, library):
    map_id = adopt()
    library.cfg("park").write_text("nonsense")
    assert found(map_id)[0].fixes == ("outside-discard",)


def test_wrong_requests(adopt, fix):
    map_id = adopt()
    with pytest.raises(UsageError):
        fix(map_id, "format-disk", [1])
    with pytest.raises(NotFound):
        fix(map_id, "remove", [77])
    with pytest.raises(Conflict):
        fix(map_id, "remove", [])


def test_a_map_without_image_has_no_findings_yet(library, found):
    with library.database.write() as session:
        record = MapRecord(slug="empty", name="Empty")
        session.add(record)
    assert found(record.id) == []
