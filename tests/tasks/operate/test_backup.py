"""A library is restored unchanged from a backup, and only complete backups have the final name."""

import errno
import hashlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import zipfile
from contextlib import closing

import pytest
from sqlalchemy import select

from webapp.app.registry import LIBRARY_PARTS
from webapp.errors import Conflict, DiskFull, InputError, NotFound, StorageError, UsageError
from webapp.files import backup
from webapp.files.backup import MANIFEST
from webapp.jobs.health import ProcessLock
from webapp.progress import Progress
from webapp.store import queries
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import edits, maps
from webapp.store.schema import Base, Job, MapRecord, QueryRecord
from webapp.tasks.maps import adopt_map, delete_map, export
from webapp.tasks.operate import backup as backup_library


@pytest.fixture
def library(tmp_path, make_map):
    """A library with two maps, one of which has an answer in its history and an additional placement."""
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    for slug in ("park", "wood"):
        make_map(library.map_folder(slug), 3)
        adopt_map.adopt_map(library, slug, account_id=owner.id)
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park").one()
        row = QueryRecord(name="q", file="q.jpg", width=4, height=3, options={}, answer={"a": 1}, evidence=[])
        queries.add(session, record, row=row, most=10)
        placed = {"placed/clusters/0": {"x_px": 1.0, "y_px": 2.0}}
        edits.apply(session, record, changes=placed, kind="placement", account_id=owner.id)
    queries.folder(library, record.id).mkdir(parents=True)
    (queries.folder(library, record.id) / "q.jpg").write_bytes(b"a photo")
    export.export_map(library, record.id)
    (library.map_folder("park") / "derived" / "large.bin").write_bytes(b"computed")
    yield library
    library.database.close()


@pytest.fixture
def archive(tmp_path):
    return tmp_path / "backups" / "library.zip"


@pytest.fixture
def back_up(library, archive):
    """Back the library up and return the report."""
    archive.parent.mkdir()

    def run(progress=None):
        return backup_library.back_up(library, archive, parts=LIBRARY_PARTS, progress=progress or Progress())

    return run


@pytest.fixture
def restore(archive, tmp_path):
    """Restore the backup elsewhere and return the library."""
    opened = []

    def run(**options):
        backup_library.restore(
            archive, tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress(), **options
        )
        opened.append(open_library(tmp_path / "restored"))
        return opened[0]

    yield run
    for library in opened:
        library.database.close()


class Meanwhile(Progress):
    """Calls a function once, after the first file was copied."""

    def __init__(self, action):
        self._action = action

    def advance(self, steps=1):
        action, self._action = self._action, lambda: None
        action()


def rows(library):
    """Return all rows of all tables except the jobs."""
    tables = [table for table in Base.metadata.sorted_tables if table.name != "job"]
    with library.database.read() as session:
        return {table.name: sorted(map(repr, session.execute(select(table)))) for table in tables}


def files(library):
    """Return hashes of all files that cannot be recomputed."""
    inner = library.inner / "queries"
    found = [
        p
        for slug in ("park", "wood")
        for p in library.map_folder(slug).rglob("*")
        if "derived" not in p.parts
    ]
    return {
        p.relative_to(library.folder): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in [*found, *inner.rglob("*")]
        if p.is_file()
    }


def move(library, x):
    """Edit the map, as a request does."""
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park").one()
        edits.apply(session, record, changes={"photo/0": {"x_px": x, "y_px": 1.0}}, kind="move", account_id=1)
    export.export_map(library, record.id)


def is_current(library, slug="park"):
    """Return whether the files of a map agree with its records."""
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
    exported = export.file_sha256(library.cfg(slug)) == record.exported_sha256
    return exported and record.exported_revision == record.revision


def test_everything_comes_back(library, back_up, restore):
    report = back_up()
    assert (report.maps, report.photos, report.missing) == (2, 6, ())
    restored = restore()
    assert rows(restored) == rows(library)
    assert files(restored) == files(library)
    assert is_current(restored) and is_current(restored, "wood")
    assert not (restored.map_folder("park") / "derived" / "large.bin").exists()
    assert not (restored.inner / "secret-key").exists()


def test_the_indexes_are_going_to_be_built(back_up, restore):
    back_up()
    with restore().database.read() as session:
        waiting = session.scalars(select(Job.map_id).where(Job.kind == "index", Job.state == "queued")).all()
    assert sorted(waiting) == [1, 2]


def test_edits_in_the_meantime_belong_to_the_next_backup(library, back_up, restore):
    before = rows(library)
    back_up(Meanwhile(lambda: move(library, 77.0)))
    assert rows(library) != before
    restored = restore()
    assert rows(restored) == before
    assert is_current(restored)


def test_a_map_that_is_deleted_in_the_meantime_is_in_it_wholly_or_not_at_all(library, back_up, restore):
    def delete():
        with library.database.write() as session:
            record = session.query(MapRecord).filter_by(slug="wood").one()
            maps.put_into_bin(record)
        delete_map.delete_map(library, record.id)

    report = back_up(Meanwhile(delete))
    assert (report.maps, report.photos, report.missing) == (1, 3, ())
    restored = restore()
    assert rows(restored) == rows(library)
    assert not restored.map_folder("wood").exists()


def test_a_file_that_the_library_has_lost_is_reported_and_the_rest_is_kept(library, back_up, restore):
    (library.map_folder("park") / "photos" / "1.jpg").unlink()
    report = back_up()
    assert report.missing == ("maps/park/photos/1.jpg",)
    assert files(restore()) == files(library)


def test_nobody_else_may_read_it(back_up, archive):
    back_up()
    assert os.name == "nt" or archive.stat().st_mode & 0o077 == 0


def test_a_backup_does_not_go_into_the_library(library):
    with pytest.raises(UsageError, match="lost with it"):
        backup_library.back_up(
            library, library.map_folder("park") / "b.zip", parts=LIBRARY_PARTS, progress=Progress()
        )


def test_a_full_disk_leaves_the_backup_before(back_up, archive, monkeypatch):
    back_up()
    before = archive.read_bytes()

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(backup.os, "fsync", full)
    with pytest.raises(DiskFull):
        back_up()
    assert archive.read_bytes() == before
    assert list(archive.parent.iterdir()) == [archive]


def test_a_kill_leaves_no_backup_and_the_next_one_is_whole(library, back_up, archive, restore):
    program = """
import os, sys, signal
from pathlib import Path
from webapp.progress import Progress
from webapp.store.library import open_library
from webapp.app.registry import LIBRARY_PARTS
from webapp.tasks.operate import backup as backup_library

class Killed(Progress):
    def advance(self, steps=1):
        os.kill(os.getpid(), signal.SIGKILL)

backup_library.run(open_library(Path(sys.argv[1])), Path(sys.argv[2]), progress=Killed())
"""
    done = subprocess.run([sys.executable, "-c", program, library.folder, archive])
    assert done.returncode != 0 and not archive.exists()
    back_up()
    assert rows(restore()) == rows(library)
    assert list(archive.parent.iterdir()) == [archive]


def rewritten(archive, change):
    """Rewrite the zip with other content."""
    with zipfile.ZipFile(archive) as old:
        content = {name: old.read(name) for name in old.namelist()}
    change(content)
    with zipfile.ZipFile(archive, "w") as new:
        for name, data in content.items():
            new.writestr(name, data)


def in_manifest(change):
    def changed(content):
        manifest = json.loads(content[MANIFEST])
        change(manifest)
        content[MANIFEST] = json.dumps(manifest)

    return changed


DAMAGES = {
    "a photo changed": lambda c: c.update({"maps/park/photos/0.jpg": c["maps/park/photos/1.jpg"]}),
    "a photo is gone": lambda c: c.pop("maps/park/photos/0.jpg"),
    "the database is another file": lambda c: c.update({"library.db": c["maps/park/photos/1.jpg"]}),
    "no manifest": lambda c: c.pop(MANIFEST),
    "half a manifest": lambda c: c.update({MANIFEST: c[MANIFEST][:100]}),
    "another program's": in_manifest(lambda m: m.update(format="other")),
    "a later version's": in_manifest(lambda m: m.update(version=2)),
    "no files": in_manifest(lambda m: m.update(files={})),
    "a way out": in_manifest(lambda m: m["files"].update({"maps/../../evil": m["files"]["library.db"]})),
    "an absolute way out": in_manifest(lambda m: m["files"].update({"/evil": m["files"]["library.db"]})),
    "into the inner folder": in_manifest(
        lambda m: m["files"].update({"maps/.library/library.db": m["files"]["library.db"]})
    ),
    "something else": in_manifest(lambda m: m["files"].update({"etc/x": m["files"]["library.db"]})),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_backup_changes_nothing(damage, back_up, archive, tmp_path):
    back_up()
    rewritten(archive, damage)
    there = tmp_path / "restored"
    there.mkdir()
    (there / "mine").write_text("mine")
    with pytest.raises(InputError):
        backup_library.restore(archive, there, force=True, parts=LIBRARY_PARTS, progress=Progress())
    assert [p.name for p in there.iterdir()] == ["mine"]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
def test_a_backup_that_was_cut_changes_nothing(share, back_up, archive, tmp_path):
    back_up()
    os.truncate(archive, int(archive.stat().st_size * share))
    with pytest.raises(InputError):
        backup_library.restore(archive, tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress())
    assert not (tmp_path / "restored").exists()


@pytest.mark.parametrize("place", [0.1, 0.35, 0.6, 0.85])
def test_each_byte_counts(place, back_up, archive, tmp_path):
    back_up()
    data = bytearray(archive.read_bytes())
    with zipfile.ZipFile(archive) as opened:
        sizes = sorted(info.header_offset for info in opened.infolist())
    data[sizes[0] + 200 + int(place * (sizes[-1] - 400))] ^= 1
    archive.write_bytes(data)
    try:
        backup_library.restore(archive, tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress())
    except (InputError, StorageError):
        assert not list(tmp_path.glob("restored/*"))
    else:  # a byte outside all files, such as the time in a header
        assert (tmp_path / "restored" / "park").is_dir()


def test_a_database_that_is_damaged_inside_is_found(back_up, archive, tmp_path):
    back_up()

    def damage(content):
        data = bytearray(content["library.db"])
        data[4096:8192] = bytes(4096)
        content["library.db"] = bytes(data)
        manifest = json.loads(content[MANIFEST])
        manifest["files"]["library.db"][1] = hashlib.sha256(data).hexdigest()
        content[MANIFEST] = json.dumps(manifest)

    rewritten(archive, damage)
    with pytest.raises(StorageError):
        backup_library.restore(archive, tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress())
    assert not list(tmp_path.glob("restored/*"))


def test_only_an_empty_folder_is_filled(back_up, archive, library):
    back_up()
    before = rows(library)
    with pytest.raises(UsageError, match="not empty"):
        backup_library.restore(archive, library.folder, parts=LIBRARY_PARTS, progress=Progress())
    assert rows(library) == before


def test_by_force_what_was_there_is_kept(library, back_up, archive):
    back_up()
    move(library, 55.0)
    library.database.close()
    report = backup_library.restore(
        archive, library.folder, force=True, parts=LIBRARY_PARTS, progress=Progress()
    )
    with library.database.read() as session:
        assert maps.find(session, "park", account=accounts.ensure_owner(session)).revision < 3
    library.database.close()
    assert {"park", "wood", ".library"} <= {p.name for p in report.before.iterdir()}
    kept = open_library(report.before)
    assert "55.0" in str(rows(kept)["photo"])
    kept.database.close()


def test_not_under_a_running_worker(library, back_up, archive):
    back_up()
    sign = ProcessLock(library.inner / "workers")
    with pytest.raises(Conflict, match="running"):
        backup_library.restore(archive, library.folder, force=True, parts=LIBRARY_PARTS, progress=Progress())
    sign.release()
    backup_library.restore(archive, library.folder, force=True, parts=LIBRARY_PARTS, progress=Progress())


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises((StorageError, NotFound)):
        backup_library.restore(
            tmp_path / "none.zip", tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress()
        )


def test_while_the_map_is_edited_all_the_time(library, back_up, restore):
    stop = threading.Event()

    def edit():
        x = 0.0
        while not stop.is_set():
            x += 1.0
            move(library, x)

    editor = threading.Thread(target=edit)
    editor.start()
    try:
        back_up()
    finally:
        stop.set()
        editor.join()
    restored = restore()
    with restored.database.read() as session:
        record = session.query(MapRecord).filter_by(slug="park").one()
    assert export.file_sha256(restored.cfg("park")) == record.exported_sha256
    assert record.revision - record.exported_revision in (0, 1)  # the last edit may not be exported yet
    export.export_map(restored, record.id)  # like the first sweep of a server
    assert is_current(restored)
    assert [line for line in restored.cfg("park").read_text().splitlines() if line.startswith("1;")] == [
        line for line in library.cfg("park").read_text().splitlines() if line.startswith("1;")
    ]


KILLED_RESTORE = """
import os, sys, signal
from pathlib import Path
from webapp.app.registry import LIBRARY_PARTS
from webapp.progress import Progress
from webapp.tasks.operate import backup

def kill(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)

left, rename = int(sys.argv[3]), Path.rename

def count(path, target):
    global left
    left -= 1
    return kill() if left < 0 else rename(path, target)

class Killed(Progress):
    advance = kill

Path.rename = count
progress = Killed() if left < 0 else Progress()
backup.restore(Path(sys.argv[1]), Path(sys.argv[2]), parts=LIBRARY_PARTS, force=True, progress=progress)
"""


@pytest.mark.parametrize("renames", [-1, 0, 2, 4], ids=["unpacking", "before", "while moving", "half moved"])
def test_a_restore_that_was_killed_is_done_again(library, back_up, archive, renames):
    back_up()
    expected = files(library)
    move(library, 55.0)
    library.database.close()
    words = [sys.executable, "-c", KILLED_RESTORE, archive, library.folder, str(renames)]
    assert subprocess.run(words).returncode == -signal.SIGKILL
    backup_library.restore(archive, library.folder, force=True, parts=LIBRARY_PARTS, progress=Progress())
    restored = open_library(library.folder)
    try:
        assert files(restored) == expected
        assert "55.0" not in str(rows(restored)["photo"])
    finally:
        restored.database.close()
    kept = [p for before in library.folder.glob(".before-restore-*") for p in before.rglob("library.db")]
    assert any("55.0" in text for text in map(raw_positions, kept)), "what was there is kept"


def raw_positions(database):
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as opened:
        return str(opened.execute("SELECT x_px FROM photo").fetchall())


@pytest.mark.parametrize(
    ("sql", "error"),
    [
        ("UPDATE photo SET path = '../../secret.jpg' WHERE id = 0", "not in its folders"),
        ("UPDATE map SET satellite_path = '/etc/hostname'", "not in its folders"),
        ("UPDATE map SET slug = '../elsewhere' WHERE slug = 'wood'", "not in its folders"),
        ("UPDATE query SET file = '../../library.db'", "not in its folders"),
        ("CREATE TRIGGER t AFTER UPDATE ON map BEGIN DELETE FROM photo; END", "triggers"),
    ],
)
def test_a_hostile_backup_changes_nothing(library, back_up, archive, tmp_path, sql, error):
    """Its checksums are valid, as it was made on purpose."""
    back_up()

    def change(content):
        database = tmp_path / "changed.db"
        database.write_bytes(content["library.db"])
        with closing(sqlite3.connect(database)) as opened:
            opened.execute(sql)
            opened.commit()
        data = content["library.db"] = database.read_bytes()
        manifest = json.loads(content[MANIFEST])
        manifest["files"]["library.db"] = [len(data), hashlib.sha256(data).hexdigest()]
        content[MANIFEST] = json.dumps(manifest)

    rewritten(archive, change)
    with pytest.raises((InputError, StorageError), match=error):
        backup_library.restore(archive, tmp_path / "restored", parts=LIBRARY_PARTS, progress=Progress())
    assert list((tmp_path / "restored").iterdir()) == []
