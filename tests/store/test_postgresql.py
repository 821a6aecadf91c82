"""Features specific to PostgreSQL: an unavailable server, several machines, and parallel writers."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DataError

from webapp.errors import DatabaseUnavailable, MissingPart, NotFound, StorageError, UsageError
from webapp.store import clock
from webapp.store import library as store_library
from webapp.store.database import Database, announce, backend_of
from webapp.store.library import DATABASE, INNER, SERVER, migrate, open_library
from webapp.store.maps import maps
from webapp.store.operate import job_views, jobs
from webapp.store.operate.jobs import Limits
from webapp.store.schema import Account, Job, MapRecord

ROOT = Path(__file__).resolve().parents[2]
LIMITS = Limits(seconds=10.0, attempts=3)


pytestmark = pytest.mark.usefixtures("postgresql_only")


@pytest.fixture
def hasty(database_url):
    """The database of the test, for sessions with short timeouts for locks."""
    database = Database(f"{database_url}&options=-clock_timeout%3D300ms")
    yield database
    database.close()


@pytest.fixture
def parks(new_account, new_map):
    """Ids of two maps with two photos each."""
    ana = new_account("ana", is_owner=True)
    return [new_map(ana, photos=2, name=name) for name in ("Park", "Yard")]


def test_edits_of_two_maps_do_not_wait_and_those_of_one_do(library, hasty, parks):
    first, second = parks
    with library.changing(first) as change:
        change.record.name = "Forest"
        with library.changing(second) as other:
            other.record.name = "Court"
        with pytest.raises(DatabaseUnavailable, match="busy"), hasty.write(locks_rows=True) as session:
            session.get_one(MapRecord, first, with_for_update=True)
    with library.database.read() as session:
        assert [session.get_one(MapRecord, id).name for id in parks] == ["Forest", "Court"]


def test_what_a_writer_reads_stays_true(library, hasty, parks):
    """A writer that locks no row excludes all others."""
    with library.database.write() as session:
        owners = session.query(Account).filter_by(is_owner=True).count()
        for locks_rows in (False, True):
            with (
                pytest.raises(DatabaseUnavailable, match="busy"),
                hasty.write(locks_rows=locks_rows) as who,
            ):
                who.get(Account, 1)
        assert session.query(Account).filter_by(is_owner=True).count() == owners
    with hasty.write() as session:
        assert session.get_one(MapRecord, parks[0]).name == "Park"


def test_numbers_that_many_edits_count_up_are_counted_once_each(library, parks):
    def reserve(_):
        with library.changing(parks[0]) as change:
            return maps.reserve_id(change.record)

    with ThreadPoolExecutor(4) as pool:
        assert sorted(pool.map(reserve, range(40))) == list(range(2, 42))


def test_two_workers_that_look_at_once_take_jobs_of_two_maps(library, parks):
    with library.database.write() as session:
        for kind in ("index", "export"):
            for id in parks:
                jobs.enqueue(session, kind, map_id=id)
    with library.database.write(locks_rows=True) as one:
        mine = jobs.lease(one, "a", limits=LIMITS)
        one.flush()
        with library.database.write(locks_rows=True) as two:
            other = jobs.lease(two, "b", limits=LIMITS)
            two.flush()
            with library.database.write(locks_rows=True) as three:
                assert jobs.lease(three, "c", limits=LIMITS) is None, "the other jobs wait for their turn"
        assert [mine.map_id, other.map_id] == parks
    with library.database.write(locks_rows=True) as session:
        assert jobs.lease(session, "c", limits=LIMITS) is None


def test_a_waiting_job_does_not_begin_before_the_edit_that_needs_it_is_there(library, parks):
    with library.database.write() as session:
        waiting = jobs.enqueue(session, "index", map_id=parks[0]).id
    with library.changing(parks[0]) as change:
        assert jobs.enqueue(change.session, "index", map_id=parks[0]).id == waiting
        with library.database.write(locks_rows=True) as session:
            assert jobs.lease(session, "a", limits=LIMITS) is None
    with library.database.write(locks_rows=True) as session:
        assert jobs.lease(session, "a", limits=LIMITS).id == waiting


def test_leases_go_by_the_clock_of_the_server(library, parks):
    with library.database.write() as session:
        jobs.enqueue(session, "index", map_id=parks[0])
        job = jobs.lease(session, "a", limits=LIMITS)
        left = session.execute(text("SELECT leased_until - clock_timestamp() AT TIME ZONE 'UTC' FROM job"))
        assert 5 < left.scalar_one().total_seconds() <= 10
        assert jobs.beat(session, jobs.Lease(job.id, job.fence), seconds=60, progress=(1, 2, "")) is not None


def test_machines_whose_clocks_differ_agree_on_how_long_a_job_works(library, parks, monkeypatch):
    for module in (jobs, job_views):
        monkeypatch.setattr(module, "now", lambda: clock.now() - timedelta(hours=1), raising=False)
    with library.database.write() as session:
        jobs.enqueue(session, "index", map_id=parks[0])
        job = jobs.lease(session, "a", limits=LIMITS)
        assert 0 <= job_views.to_json(session, job)["seconds"] < 60
        jobs.finish(session, jobs.Lease(job.id, job.fence))
        assert 0 <= job_views.to_json(session, job)["seconds"] < 60


@pytest.mark.parametrize("minutes", [-1, 1])
def test_a_worker_whose_clock_is_a_minute_off_neither_takes_nor_loses_a_job(
    library, parks, monkeypatch, minutes
):
    """In both directions; the clock of the program is off, not that of the server."""

    class Shifted(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + timedelta(minutes=minutes)

    def take(who):
        with library.database.write(locks_rows=True) as session:
            return jobs.lease(session, who, limits=LIMITS)

    for id in parks:
        with library.database.write() as session:
            jobs.enqueue(session, "index", map_id=id)
    right = take("right")
    with monkeypatch.context() as context:
        context.setattr(clock, "datetime", Shifted)
        assert abs(clock.now() - datetime.now(UTC)) > timedelta(seconds=50)
        off = take("off")
        assert (right.map_id, off.map_id) == (parks[0], parks[1])
        assert take("off") is None, "the lease of the other one lasts"
        with library.database.write() as session:
            held = jobs.Lease(off.id, off.fence)
            assert jobs.beat(session, held, seconds=10.0, progress=(1, 2, "")) is not None
            assert job_views.queue_figures(session).abandoned == 0
    assert take("right") is None, "its own lease lasts as long for others"
    with library.database.write() as session:
        session.execute(text("UPDATE job SET leased_until = clock_timestamp() AT TIME ZONE 'UTC'"))
    assert {take("right").id, take("right").id} == {right.id, off.id}


def test_a_statement_that_takes_too_long_is_stopped(database_url):
    slow = Database(f"{database_url}&options=-cstatement_timeout%3D100ms")
    with pytest.raises(DatabaseUnavailable, match="took too long, and was stopped"), slow.read() as session:
        session.execute(text("SELECT pg_sleep(60)"))
    with slow.read() as session:
        assert session.query(Account).count() == 0
    slow.close()


def test_copying_rows_is_refused_in_words_too(library):
    with pytest.raises(DatabaseUnavailable, match="read-only"), library.database.write() as session:
        session.execute(text("SET TRANSACTION READ ONLY"))
        backend_of(session).insert(session.connection(), "member", columns=["map_id"], rows=[[1]])


def test_what_it_refuses_for_other_reasons_is_no_number_that_is_too_large(library):
    with pytest.raises(DataError), library.database.write() as session:
        session.add(Job(kind="index", arguments={"share": float("nan")}))
    with pytest.raises(NotFound, match="too large"), library.database.read() as session:
        session.get(Job, 2**31)


def woken(watch):
    """Wait until a change is announced."""
    until = time.monotonic() + 60
    while not watch.wait(0.5):
        assert time.monotonic() < until
    return True


def test_who_watches_is_woken_by_what_is_kept(library, hasty):
    with hasty.watch("a", look_s=0.0) as watch, hasty.watch("b", look_s=0.0) as other:
        assert woken(watch) and woken(other)  # the listeners are connected now
        with pytest.raises(KeyError), library.database.write() as session:
            announce(session.connection(), "b")
            raise KeyError
        with library.database.write() as session:
            announce(session.connection(), "a")
        assert watch.wait(60)
        assert not other.wait(0.0)


def test_who_watches_is_woken_also_after_a_lost_connection(library, hasty):
    others = text("SELECT pid FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND query LIKE 'LISTEN%'")
    with hasty.watch("a", look_s=0.0) as watch:
        assert woken(watch)
        with library.database.write() as session:
            for pid in session.scalars(others).all():
                session.execute(text(f"SELECT pg_terminate_backend({pid})"))
        for _ in range(3):  # by the lost connection, by the new one, and by the notice
            with library.database.write() as session:
                announce(session.connection(), "a")
            assert woken(watch)


def test_a_server_that_is_killed_loses_nothing_acknowledged_and_is_found_again(library, parks, postgresql):
    with (
        pytest.raises(DatabaseUnavailable, match="cannot be reached") as refused,
        library.changing(parks[0]) as change,
    ):
        change.record.name = "Lost"
        change.session.flush()
        postgresql.stop()
    assert refused.value.wait_s > 0 and "expmap" in refused.value.where
    with pytest.raises(DatabaseUnavailable), library.database.read() as session:
        session.get(MapRecord, parks[0])
    with pytest.raises(StorageError, match="cannot be reached") as caught:
        open_library(library.folder, url=library.database.engine.url.render_as_string(hide_password=False))
    assert "EXPMAP_DATABASE" in caught.value.hint
    postgresql.start()
    with library.database.read() as session:
        assert [session.get_one(MapRecord, id).name for id in parks] == ["Park", "Yard"]


def test_a_connection_that_is_cut_is_refused_once(library, parks):
    cut = text("SELECT pg_terminate_backend(pg_backend_pid())")
    with pytest.raises(DatabaseUnavailable, match="cannot be reached"), library.changing(parks[0]) as change:
        change.session.execute(cut)
    with library.changing(parks[0]) as change:
        assert change.record.name == "Park"


def test_connections_that_broke_while_nobody_used_them_are_replaced(library, parks, hasty):
    with library.database.read() as first, library.database.read() as second:
        assert [s.get_one(MapRecord, parks[0]).name for s in (first, second)] == ["Park", "Park"]
    others = "FROM pg_stat_activity WHERE datname = current_database() AND pid != pg_backend_pid()"
    with hasty.write() as session:
        assert session.scalar(text(f"SELECT count(pg_terminate_backend(pid)) {others}")) >= 2
    for open_session in (library.database.read, library.database.write):
        with open_session() as session:
            assert session.get_one(MapRecord, parks[0]).name == "Park"


def test_a_read_that_loses_its_connection_is_refused_and_the_next_one_is_not(library, parks):
    cut = text("SELECT pg_terminate_backend(pg_backend_pid())")
    with pytest.raises(DatabaseUnavailable, match="cannot be reached"), library.database.read() as session:
        session.execute(cut)
    with library.database.read() as session:
        assert session.get_one(MapRecord, parks[0]).name == "Park"


def test_a_read_only_server_says_so(library, database_url):
    standby = Database(f"{database_url}&options=-cdefault_transaction_read_only%3Don")
    with pytest.raises(DatabaseUnavailable, match="read-only"), standby.write() as session:
        session.add(Account(name="Eva", is_owner=False))
    with standby.read() as session:
        assert session.query(Account).count() == 0
    standby.close()


def test_folder_and_database_must_be_of_one_library(library, database_url, postgresql, tmp_path):
    with pytest.raises(StorageError, match="in a database server"):
        open_library(library.folder)
    with pytest.raises(StorageError, match="not that of the library in the database"):
        open_library(tmp_path / "not-mounted", url=database_url)
    empty = postgresql.new_database(empty=True)
    (tmp_path / "maps" / "park").mkdir(parents=True)
    with pytest.raises(StorageError, match="not that of the library in the database"):
        open_library(tmp_path / "maps", url=empty)
    (tmp_path / "lite" / INNER).mkdir(parents=True)
    (tmp_path / "lite" / INNER / DATABASE).touch()
    with pytest.raises(StorageError, match="in SQLite"):
        open_library(tmp_path / "lite", url=empty)
    for _ in range(2):
        open_library(tmp_path / "new", url=empty).database.close()
    postgresql.drop(empty)
    (tmp_path / "new" / "park").mkdir()
    empty = postgresql.new_database(empty=True)
    with pytest.raises(StorageError, match="not that of the library in the database"):
        open_library(tmp_path / "new", url=empty)
    postgresql.drop(empty)


def test_the_folder_of_one_library_is_refused_with_the_database_of_another(postgresql, tmp_path):
    urls = {name: postgresql.new_database(empty=True) for name in ("city", "park")}
    for name, url in urls.items():
        open_library(tmp_path / name, url=url).database.close()
    with pytest.raises(StorageError, match="are of two libraries") as refused:
        open_library(tmp_path / "city", url=urls["park"])
    assert refused.value.where == str(tmp_path / "city")
    open_library(tmp_path / "city", url=urls["city"]).database.close()
    for url in urls.values():
        postgresql.drop(url)


def test_a_library_of_an_older_version_gets_its_key_when_it_is_opened(postgresql, tmp_path):
    url, marker = postgresql.new_database(empty=True), tmp_path / "library" / INNER / SERVER
    open_library(tmp_path / "library", url=url).database.close()
    address, key = marker.read_text().splitlines()
    marker.write_text(f"{address}\n")
    open_library(tmp_path / "library", url=url).database.close()
    assert marker.read_text() == f"{address}\n{key}\n", "that of the database"
    database = Database(url)
    with database.engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE library_key")
    database.close()
    open_library(tmp_path / "library", url=url).database.close()
    marker.write_text(f"{address}\nanother\n")
    with pytest.raises(StorageError, match="are of two libraries"):
        open_library(tmp_path / "library", url=url)
    postgresql.drop(url)


def test_who_is_killed_at_the_first_start_can_start_again(postgresql, tmp_path, monkeypatch):
    def killed(database):
        migrate(database)
        raise KeyboardInterrupt

    empty = postgresql.new_database(empty=True)
    with monkeypatch.context() as context, pytest.raises(KeyboardInterrupt):
        context.setattr(store_library, "migrate", killed)
        open_library(tmp_path / "library", url=empty)
    open_library(tmp_path / "library", url=empty).database.close()
    postgresql.drop(empty)


def test_a_database_of_another_encoding_is_refused(postgresql, tmp_path):
    url = postgresql.new_database(empty=True, encoding="SQL_ASCII")
    with pytest.raises(StorageError, match="encoding") as refused:
        open_library(tmp_path / "library", url=url)
    assert "LOCALE 'C'" in refused.value.hint
    postgresql.drop(url)


def test_a_text_that_it_cannot_keep_is_refused(library):
    with pytest.raises(UsageError, match="character"), library.database.write() as session:
        session.add(Account(name="a\0b"))


def test_without_its_driver_it_says_what_to_install(absent):
    absent("cluster")
    with pytest.raises(MissingPart, match="psycopg"):
        Database("postgresql+psycopg://localhost/expmap")


def test_a_command_without_the_server_ends_with_one_line(tmp_path):
    environ = {**os.environ, "EXPMAP_DATABASE": f"postgresql+psycopg://me:secret@/x?host={tmp_path}"}
    command = [sys.executable, "-m", "webapp", "account", "list", "--library", tmp_path / "library"]
    ended = subprocess.run(command, env=environ, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.count("\n") == 1 and "the database server cannot be reached" in ended.stderr
    assert "secret" not in ended.stderr


def test_a_job_outlives_the_database(library, parks, postgresql):
    """An acknowledged lease survives a restart."""
    with library.database.write() as session:
        jobs.enqueue(session, "index", map_id=parks[0])
    with library.database.write(locks_rows=True) as session:
        held = jobs.lease(session, "a", limits=LIMITS)
    postgresql.stop()
    postgresql.start()
    with library.database.write() as session:
        assert jobs.finish(session, jobs.Lease(held.id, held.fence), result={"fine": True})
    with library.database.read() as session:
        assert session.get_one(Job, held.id).state == "done"
