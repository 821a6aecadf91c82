"""While files are read and copied, others can write to the database."""

import sqlite3

import pytest

from webapp.files.decode import check_decodes
from webapp.settings import Settings
from webapp.store.library import DATABASE
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import duplicate_map
from webapp.tasks.maps import adopt_map, export, findings, outside_edit

SETTINGS = Settings()


@pytest.fixture
def others_write(library):
    """Write like another process that does not wait, and count how often."""
    done = []

    def write(*_args, **_named):
        raw = sqlite3.connect(library.inner / DATABASE, timeout=0, isolation_level=None)
        raw.execute("BEGIN IMMEDIATE")
        raw.execute("ROLLBACK")
        raw.close()
        done.append(1)

    write.done = done
    return write


@pytest.fixture
def watched_photos(monkeypatch, others_write):
    """Write to the database whenever a photo is read."""

    def check(path, **limits):
        others_write()
        return check_decodes(path, **limits)

    monkeypatch.setattr(adopt_map, "check_decodes", check)
    return others_write.done


def test_photos_of_the_folder_are_read_before(adopt, library, owner, save_photo, watched_photos, rows):
    map_id = adopt()
    for number in (7, 8):
        save_photo(library.map_folder("park") / "photos" / f"new{number}.jpg", number)
    watched_photos.clear()
    findings.fix_findings(library, map_id, fix="adopt", ids=(), account_id=owner, settings=SETTINGS)
    assert len(watched_photos) == 2
    assert [row.name for row in rows(map_id).values() if row.x_px is None] == ["new7.jpg", "new8.jpg"]


def test_photos_of_a_changed_file_are_read_before(adopt, library, owner, save_photo, watched_photos, rows):
    map_id = adopt()
    save_photo(library.map_folder("park") / "photos" / "new.jpg", 7)
    with library.cfg("park").open("a") as file:
        file.write("9;photos/new.jpg;1;2\n")
    shown = outside_edit.show(library, map_id, settings=SETTINGS)
    watched_photos.clear()
    outside_edit.take(library, map_id, account_id=owner, settings=SETTINGS, sha256=shown["sha256"])
    assert len(watched_photos) == 1
    assert rows(map_id)[9].name == "new.jpg"


def test_a_copy_is_made_before(adopt, library, owner, monkeypatch, others_write):
    map_id = adopt()
    link = duplicate_map.os.link

    def slow_link(*arguments):
        others_write()
        link(*arguments)

    monkeypatch.setattr(duplicate_map.os, "link", slow_link)
    slug = duplicate_map.duplicate_map(library, map_id, account_id=owner, name="Copy")
    assert len(others_write.done) >= 4  # an image and three photos
    assert (library.map_folder(slug) / "plan.png").is_file()


def test_what_came_into_the_map_meanwhile_is_not_adopted_twice(
    adopt, library, owner, save_photo, monkeypatch, rows
):
    map_id = adopt()
    save_photo(library.map_folder("park") / "photos" / "new.jpg", 7)
    read = findings._orphaned_photos
    again = []

    def strangers(*arguments, **named):
        found = read(*arguments, **named)
        if not again:
            again.append(1)
            findings.fix_findings(library, map_id, fix="adopt", ids=(), account_id=owner, settings=SETTINGS)
        return found

    monkeypatch.setattr(findings, "_orphaned_photos", strangers)
    with pytest.raises(findings.Conflict, match="nothing left to fix"):
        findings.fix_findings(library, map_id, fix="adopt", ids=(), account_id=owner, settings=SETTINGS)
    assert [row.name for row in rows(map_id).values()].count("new.jpg") == 1


def test_a_copy_that_cannot_be_registered_leaves_nothing(adopt, library, owner, monkeypatch):
    map_id = adopt()

    def refuse(*_arguments):
        raise OSError("no")

    monkeypatch.setattr(duplicate_map.adopt_map, "queue_derived", refuse)
    with pytest.raises(OSError, match="no"):
        duplicate_map.duplicate_map(library, map_id, account_id=owner, name="Copy")
    assert sorted(path.name for path in library.folder.iterdir()) == [".library", "park"]
    assert list((library.inner / "imports").iterdir()) == []
    with library.database.read() as session:
        assert session.query(MapRecord).count() == 1
    export.export_map(library, map_id)
