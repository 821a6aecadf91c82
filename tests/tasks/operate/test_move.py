"""The records of a library move from SQLite to PostgreSQL and back unchanged, and are in one place only."""

import hashlib
import os
import signal
from pathlib import Path

import pytest

from tests import killing
from tests.killing import Step
from tests.tasks.operate.moves import (
    ZERO_AT_THE_END,
    Stop,
    StopAt,
    file_url,
    hashes,
    new_query,
    opens,
    to_file,
    to_server,
)
from webapp.errors import StorageError, UsageError
from webapp.missions.store.schema import TrackProfile
from webapp.store.accounts import accounts
from webapp.store.database import Database
from webapp.store.library import DATABASE, SERVER, open_library
from webapp.store.moving import copying, marks
from webapp.store.operate import jobs
from webapp.store.schema import Account, Job, Photo, QueryRecord
from webapp.tasks.operate import move
from webapp.tasks.operate.move import TICKET

pytestmark = pytest.mark.slow  # `test_backup_of_either.py` moves records between both databases, too


def files(folder):
    return {
        p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file() and ".library" not in p.parts and not p.name.endswith("lock")
    }


def test_a_move_killed_between_its_marks_is_completed_with_its_own_address_only(folder, server, monkeypatch):
    url, elsewhere = server(), server()
    write = move.write_text

    def stop_at_the_marker(path, text):
        if path.name == SERVER:
            raise Stop
        write(path, text)

    with monkeypatch.context() as patched:
        patched.setattr(move, "write_text", stop_at_the_marker)
        with pytest.raises(Stop):
            to_server(folder, url)
    with pytest.raises(StorageError, match="have moved to"):
        to_server(folder, elsewhere)
    to_server(folder, url)
    assert opens(folder, url)


def test_all_is_the_same_there_and_back(folder, server, tmp_path):
    url, before, photos = server(), hashes(file_url(folder), tmp_path), files(folder)
    assert {copy.name for copy in before if copy.rows} > {"account", "map", "photo", "pose", "edit", "query"}
    there = to_server(folder, url)
    assert there.tables == before
    assert hashes(url, tmp_path) == before
    library = open_library(folder, url=url)
    with library.database.read() as session:
        assert session.query(Account).filter_by(created_at=ZERO_AT_THE_END).one().name.endswith("🗺")
        assert session.get_one(Photo, (1, 1)).y_px == 1 / 3
        assert session.get_one(TrackProfile, (1, 0)).points == bytes(range(256))
    library.database.close()
    back = to_file(folder, url)
    assert back.tables == before
    assert hashes(file_url(folder), tmp_path) == before
    assert files(folder) == photos
    open_library(folder).database.close()


def test_no_id_is_given_again(folder, server):
    library = open_library(folder)

    def add(name):
        with library.database.write() as session:
            row = new_query(name)
            session.add(row)
            session.flush()
            job = jobs.enqueue(session, "index", map_id=1, key=name)
            return row.id, job.id, accounts.create(session, name).id

    def delete(ids):
        with library.database.write() as session:
            for kind, id in zip((QueryRecord, Job, Account), ids, strict=True):
                session.delete(session.get_one(kind, id))
        library.database.close()

    last = add("deleted before")
    delete(last)
    url = server()
    to_server(folder, url)
    library = open_library(folder, url=url)
    first, last = last, add("after the deleted one")
    assert last == tuple(id + 1 for id in first)
    delete(last)
    to_file(folder, url)
    library = open_library(folder)
    first, last = last, add("back")
    assert last == tuple(id + 1 for id in first)
    library.database.close()


def test_what_was_left_says_where_all_is(folder, server):
    url = server()
    kept = Path(to_server(folder, url).kept)
    with pytest.raises(StorageError, match=r"in a database server.*--to sqlite"):
        open_library(folder)
    with pytest.raises(UsageError, match="in a database server already"):
        to_server(folder, url)
    to_file(folder, url)
    with pytest.raises(StorageError, match=f"moved to .*{DATABASE}"):
        open_library(folder, url=url)
    with pytest.raises(UsageError, match="in SQLite already"):
        to_file(folder, url)
    with pytest.raises(UsageError, match="is not empty"):
        to_server(folder, url)
    assert kept.exists()
    assert to_server(folder, server()).tables, "an empty one is needed"


def test_the_old_file_is_not_taken_for_the_library(folder, server):
    kept = Path(to_server(folder, server()).kept)
    (folder / ".library" / SERVER).unlink()
    kept.rename(folder / ".library" / DATABASE)
    with pytest.raises(StorageError, match="have moved to postgresql"):
        open_library(folder)


@pytest.mark.parametrize("where", ["sqlite", "postgresql"])
def test_who_still_has_the_old_database_open_writes_nothing(folder, server, where, monkeypatch):
    monkeypatch.setattr("webapp.tasks.operate.move.check_alone", lambda connection: None)
    url = server()
    if where == "postgresql":
        to_server(folder, url)
        stale = Database(url)
        with stale.write() as session:
            session.add(Account(name="early"))
        to_file(folder, url)
    else:
        stale = Database(f"sqlite:///{to_server(folder, url).kept}")
    for locks_rows in (False, True):
        with pytest.raises(StorageError, match="have moved"), stale.write(locks_rows=locks_rows) as session:
            session.add(Account(name="late"))
    with stale.read() as session:
        assert session.query(Account).filter_by(name="late").count() == 0
    stale.close()


def test_a_stopped_move_goes_on(folder, server, tmp_path):
    url, before = server(), hashes(file_url(folder), tmp_path)
    with pytest.raises(Stop):
        to_server(folder, url, StopAt("pose"))
    with pytest.raises(StorageError, match="has not finished"):
        open_library(tmp_path / "other", url=url)
    open_library(folder).database.close()
    other = server()
    assert to_server(folder, url).tables == before
    with pytest.raises(Stop):
        to_file(folder, url, StopAt("pose"))
    open_library(folder, url=url).database.close()
    assert to_file(folder, url).tables == before
    assert not (folder / ".library" / TICKET).exists()
    assert to_server(folder, other).tables == before


@pytest.mark.parametrize("where", ["sqlite", "postgresql"])
def test_a_library_that_was_used_meanwhile_is_copied_anew(folder, server, where):
    url = server()
    if where == "postgresql":
        to_server(folder, url)
    there = to_file if where == "postgresql" else to_server
    with pytest.raises(Stop):
        there(folder, url, StopAt("pose"))
    library = open_library(folder, url=url if where == "postgresql" else None)
    with library.database.write() as session:
        session.query(Account).filter_by(created_at=ZERO_AT_THE_END).one().name = "changed"
    library.database.close()
    there(folder, url)
    library = open_library(folder, url=None if where == "postgresql" else url)
    with library.database.read() as session:
        assert session.query(Account).filter_by(name="changed").count() == 1
    library.database.close()


STEPS = [
    (move, "prepare"),
    (copying, "_insert"),
    (copying, "_read"),
    (move, "copy_records"),
    (marks, "mark_moved"),
    (move, "_move"),
    (marks, "unmark_filling"),
    (move, "write_text"),
    (move, "_join_journal"),
    (move, "sync_folder"),
]
"""The steps of a move, in order; it is killed before and after the first call of each."""


def run_until(monkeypatch, step, run):
    """Run in a separate process, which is killed at a step; return whether it got there."""
    module, name, after = step
    done = getattr(module, name)

    def killed(*args, **options):
        if after:
            done(*args, **options)
        os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if child == 0:
        setattr(module, name, killed)
        try:
            run()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


@pytest.mark.parametrize("where", ["sqlite", "postgresql"])
@pytest.mark.slow
def test_a_move_can_be_killed_anywhere(folder, server, where, monkeypatch, tmp_path):
    url, before = server(), hashes(file_url(folder), tmp_path)
    if where == "postgresql":
        to_server(folder, url)
    there = to_file if where == "postgresql" else to_server
    old, new = (None, url) if where == "sqlite" else (url, None)
    seen = []
    for module, name in STEPS:
        for after in (False, True):
            if run_until(monkeypatch, (module, name, after), lambda: there(folder, url)):
                seen.append((name, opens(folder, old), opens(folder, new)))
    assert len(seen) >= 14
    assert not any(old_opens and new_opens for _, old_opens, new_opens in seen)
    assert seen[0][1], "before all is there, the old one can be used"
    try:
        there(folder, url)
    except UsageError as error:
        assert "already" in str(error), "the last one was killed when all was done"
    assert (opens(folder, old), opens(folder, new)) == (False, True)
    assert hashes(url if where == "sqlite" else file_url(folder), tmp_path) == before
    assert not (folder / ".library" / TICKET).exists()


IN_TABLES = [
    Step("webapp.store.moving.copying:_copied", calls=3),
    Step("webapp.store.moving.copying:_insert", calls=2, is_after=True),
    Step("webapp.store.moving.copying:_read", calls=8),
    Step("webapp.store.moving.copying:_copied", calls=20, is_after=True),
]


@pytest.mark.parametrize("where", ["sqlite", "postgresql"])
@pytest.mark.slow
def test_a_move_killed_within_and_between_tables_goes_on(folder, server, where, tmp_path):
    url, before = server(), hashes(file_url(folder), tmp_path)
    if where == "postgresql":
        to_server(folder, url)
    there = to_file if where == "postgresql" else to_server
    old, new = (None, url) if where == "sqlite" else (url, None)
    for step in IN_TABLES:
        assert killing.run_until(step, there, folder, url), step
        assert (opens(folder, old), opens(folder, new)) == (True, False), step
    assert there(folder, url).tables == before
    assert hashes(url if where == "sqlite" else file_url(folder), tmp_path) == before


def test_a_move_that_is_completed_names_the_file_that_was_kept(folder, server, monkeypatch):
    url = server()

    def fail(*args):
        raise Stop

    with monkeypatch.context() as patched:
        patched.setattr("webapp.tasks.operate.move.marks.unmark_filling", fail)
        with pytest.raises(Stop):
            to_server(folder, url)
    (kept,) = (folder / ".library").glob("library-until-*.db")
    kept = kept.rename(kept.with_name("library-until-20200101T000000.db"))
    assert Path(to_server(folder, url).kept) == kept
