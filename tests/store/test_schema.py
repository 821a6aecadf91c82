"""The migrations create exactly the program's tables, from nothing and from version 0.7.0."""

import sqlite3
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError

import webapp.missions.store.schema  # noqa: F401  (its tables are part of the database)
import webapp.store.accounts.identities  # noqa: F401
import webapp.store.accounts.one_time_codes  # noqa: F401
import webapp.store.accounts.passkeys  # noqa: F401
import webapp.store.maps.photo_vectors  # noqa: F401
import webapp.store.photo_libraries  # noqa: F401
from webapp.errors import NotFound, StorageError
from webapp.missions.store import shares as mission_shares
from webapp.missions.store.schema import Mission, MissionShare
from webapp.store import library as store_library
from webapp.store import sharing
from webapp.store.database import Database
from webapp.store.library import (
    DATABASE,
    INNER,
    Library,
    migrate,
    newest_schema,
    open_library,
    schema_version,
)
from webapp.store.maps import edits
from webapp.store.moving.marks import MARKS
from webapp.store.operate import jobs
from webapp.store.schema import Account, ApiToken, Base, Job, MapRecord, Photo, Share


def test_the_migrations_make_the_tables(library):
    compared = {"include_name": lambda name, kind, _: kind != "table" or name not in MARKS}
    with library.database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts=compared)
        assert compare_metadata(context, Base.metadata) == []


def test_the_newest_schema_is_that_of_a_new_library(library):
    assert schema_version(library.database) == newest_schema()


def test_opening_again_changes_nothing(library, database_url, new_account):
    new_account("ana")
    again = open_library(library.folder, url=database_url)
    with again.database.read() as session:
        assert session.connection().exec_driver_sql("SELECT name FROM account").scalars().all() == ["ana"]
    again.database.close()


@pytest.fixture
def released(tmp_path):
    """An open database as made by version 0.7.0, with a shared map and a shared mission."""
    path = tmp_path / "library.db"
    with sqlite3.connect(path) as raw:
        raw.executescript(Path(__file__).with_name("library_0_7_0.sql").read_text("utf-8"))
    raw.close()
    database = Database(f"sqlite:///{path.as_posix()}")
    yield database
    database.close()


def test_a_library_of_0_7_0_opens_with_all_that_is_in_it(released):
    migrate(released)
    with released.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
    with released.read() as session:
        photo = session.get_one(Photo, (1, 0))
        assert (photo.x_px, photo.revision, photo.is_placed) == (10.0, 4, True)
        assert session.get_one(Account, 1).name == "ana"
    edited = Library(Path(), released)
    with edited.changing(1) as change:
        edits.undo(change.session, change.record, account_id=1)
    assert change.job is not None
    with released.read() as session:
        assert not session.get_one(Photo, (1, 0)).is_placed


def test_links_of_0_7_0_open_what_they_did(released):
    migrate(released)
    with released.read() as session:
        opened = sharing.open_share(session, "map-secret")
        assert (opened.map.slug, opened.query, opened.share.localize) == ("park", None, True)
        answer = sharing.open_share(session, "answer-public")
        assert answer.query is not None and (answer.share.photos, answer.share.originals) == (False, True)
        assert [one.share.public_token for one in sharing.public(session)] == ["answer-public"]
        mission = mission_shares.open_share(session, "mission-secret")
        assert (mission.mission.name, mission.share.photos) == ("Walk", True)
        assert [one.share.public_token for one in mission_shares.public(session)] == ["mission-public"]
        with pytest.raises(NotFound):
            sharing.open_share(session, "mission-secret")


def test_ids_of_its_deleted_jobs_are_not_used_again(released):
    migrate(released)
    with released.write() as session:
        assert [job.id for job in jobs.list_jobs(session)] == [1]
        session.delete(session.get_one(Job, 1))
        session.flush()
        assert jobs.enqueue(session, "index").id == 2
        waiting = "SELECT sql FROM sqlite_master WHERE name = 'uq_job_waiting'"
        index = session.connection().exec_driver_sql(waiting).scalar_one()
        assert "UNIQUE" in index and "WHERE state = 'queued'" in index


@pytest.mark.parametrize(
    ("revision", "way"),
    [("0006", "open the library once with version 0.7.0"), ("9999", "update the program")],
)
def test_other_schemas_are_refused_with_the_way_out(released, revision, way):
    with released.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = :it"), {"it": revision})
    with pytest.raises(StorageError, match="version") as refused:
        migrate(released)
    assert way in refused.value.hint


def test_tables_of_short_rows_keep_what_they_have_and_need_no_index(released):
    rows = {
        "sign_in_link": ("hash", 1, "2026-01-01", None),
        "member": (1, 1, "owner"),
        "placed_elsewhere": (1, "Walk", 0, 1.5, 2.5),
    }
    with released.write() as session:
        for table, row in rows.items():
            marks = ", ".join("?" * len(row))
            session.connection().exec_driver_sql(f"INSERT INTO {table} VALUES ({marks})", row)
    _add_orphan(released)
    migrate(released)
    with released.write() as session:
        run = session.connection().exec_driver_sql
        for table, row in rows.items():
            assert run(f"SELECT * FROM {table}").all() == [row]
        for table in (*rows, "ended_session"):
            made = run(f"SELECT sql FROM sqlite_master WHERE name = '{table}'").scalar_one()
            assert made.rstrip().endswith("WITHOUT ROWID"), made
        assert run("PRAGMA foreign_key_check").all() == []
        run("DELETE FROM account WHERE id = 1")
        for table in ("sign_in_link", "member"):
            assert run(f"SELECT count(*) FROM {table}").scalar_one() == 0, "goes with its account"
        run("DELETE FROM map WHERE id = 1")
        assert run("SELECT count(*) FROM placed_elsewhere").scalar_one() == 0, "goes with its map"


@pytest.fixture
def earlier(tmp_path):
    """A library of the schema just before ids were used once only, with rows in all kinds of tables."""
    inner = tmp_path / INNER
    (inner / "uploads").mkdir(parents=True)
    with sqlite3.connect(inner / DATABASE) as raw:
        raw.executescript(Path(__file__).with_name("library_0_7_0.sql").read_text("utf-8"))
    raw.close()
    database = Database(f"sqlite:///{(inner / DATABASE).as_posix()}")
    config = Config()
    config.set_main_option("script_location", str(Path(store_library.__file__).parent / "migrations"))
    before = ScriptDirectory.from_config(config).get_revision("0027").down_revision
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, before)
        connection.commit()
    with database.write() as session:
        run = session.connection().exec_driver_sql
        for table, row in EARLIER_ROWS.items():
            run(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", row)
    yield database
    database.close()


EARLIER_ROWS = {
    "api_token": (4, 1, "robot", "hash", "2026-01-01", None),
    "member": (1, 1, "owner"),
    "sign_in_link": ("hash", 1, "2026-01-01", None),
    "placed_elsewhere": (1, "Walk", 0, 1.5, 2.5),
}


def everything(database):
    """All rows of all tables but Alembic's, and the definitions of all indexes."""
    with database.read() as session:
        run = session.connection().exec_driver_sql
        tables = run("SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'")
        names = sorted({name for (name,) in tables} - {"alembic_version"})
        rows = {name: run(f'SELECT * FROM "{name}"').all() for name in names}
        indexes = run("SELECT name, sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL").all()
        return rows, dict(indexes)


def test_ids_are_used_once_in_a_library_that_used_them_again(earlier):
    before = everything(earlier)
    assert all(before[0][table] for table in (*EARLIER_ROWS, "account", "map", "share", "mission_share"))
    (Path(earlier.engine.url.database).parent / "uploads" / f"{'a' * 32}.77.10.track").touch()
    migrate(earlier)
    after = everything(earlier)
    for table, rows in before[0].items():  # later migrations add columns
        assert [new[: len(old)] for old, new in zip(rows, after[0][table], strict=True)] == rows, table
    assert after[1].items() >= before[1].items(), "nothing else changed"
    with earlier.write() as session:
        run = session.connection().exec_driver_sql
        assert run("PRAGMA foreign_key_check").all() == []
        for table, last in {"map": 1, "api_token": 4, "share": 2, "mission_share": 2}.items():
            assert run(f"SELECT seq FROM sqlite_sequence WHERE name = '{table}'").scalar_one() == last
        session.add(Account(name="eva"))
        session.flush()
        assert session.query(Account).filter_by(name="eva").one().id == 78, "77 still has a staged file"
        run("DELETE FROM account WHERE id = 1")
        assert [run(f"SELECT count(*) FROM {table}").scalar_one() for table in ("member", "api_token")] == [
            0,
            0,
        ]
        assert run("SELECT account_id FROM share").scalars().all() == [None, None], "the links stay"
        with pytest.raises(IntegrityError):
            run("INSERT INTO member VALUES (1, 99, 'viewer')")


def test_what_belongs_to_somebody_never_has_the_id_of_something_deleted(library, new_account, new_map):
    ana = new_account("ana", is_owner=True)
    map_id, mission = new_map(ana), _added(library, Mission(name="Walk"))
    for make in (
        lambda: Account(name="eva"),
        lambda: MapRecord(slug="yard", name="Yard"),
        lambda: ApiToken(account_id=ana.id, name="robot", token_hash="a"),
        lambda: Share(map_id=map_id, token_hash="b"),
        lambda: MissionShare(mission_id=mission, token_hash="c"),
        lambda: Mission(name="Ride"),
    ):
        first = _added(library, make())
        with library.database.write() as session:
            session.delete(session.get_one(type(make()), first))
        assert _added(library, make()) > first, type(make())


def _added(library, row):
    """Store a row and return its id."""
    with library.database.write() as session:
        session.add(row)
        session.flush()
        return row.id


def _add_orphan(database):
    """Add a member of a missing map, as a program without checks of foreign keys could."""
    with sqlite3.connect(database.engine.url.database) as raw:
        raw.execute("INSERT INTO member VALUES (99, 1, 'viewer')")
    raw.close()
