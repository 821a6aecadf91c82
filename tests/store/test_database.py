"""Sessions commit everything or nothing, and raise clear errors."""

import sqlite3

import pytest
from sqlalchemy import event
from sqlalchemy.exc import IntegrityError, OperationalError

from webapp.errors import DatabaseUnavailable, NotFound, StorageError
from webapp.store.database import Database
from webapp.store.library import open_library
from webapp.store.schema import Account, Photo


def test_an_error_keeps_nothing(library, new_account):
    with pytest.raises(ZeroDivisionError), library.database.write() as session:
        session.add(Account(name="ana"))
        session.flush()
        raise ZeroDivisionError
    with library.database.read() as session:
        assert session.get(Account, 1) is None


def test_a_number_that_no_column_can_hold_is_not_found(library):
    with pytest.raises(NotFound, match="too large"), library.database.read() as session:
        session.get(Photo, (1, 10**30))


def test_a_record_that_somebody_has_deleted_is_not_found(library):
    with pytest.raises(NotFound, match="this was deleted"), library.database.write() as session:
        session.get_one(Account, 7)


def test_a_writer_waits_for_the_others_and_sees_what_they_wrote(library, new_account):
    ana = new_account("ana")
    seen = []
    with library.database.write() as session:
        session.get(Account, ana.id).epoch = ana.epoch + 1
        with library.database.read() as reader:
            seen.append(reader.get(Account, ana.id).epoch)
    with library.database.read() as reader:
        seen.append(reader.get(Account, ana.id).epoch)
    assert seen == [ana.epoch, ana.epoch + 1]


@pytest.mark.usefixtures("sqlite_only")
def test_it_is_written_through_to_the_disk(library):
    with library.database.engine.connect() as connection:
        modes = [
            connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in ("journal_mode", "synchronous")
        ]
    assert modes == ["wal", 2]


def test_a_database_that_cannot_be_opened_is_an_error_in_words(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'none' / 'library.db'}")
    with pytest.raises(StorageError, match="unable to open"), database.read() as session:
        session.get(Account, 1)


@pytest.mark.usefixtures("sqlite_only")
def test_a_full_disk_is_an_error_in_words(library):
    def full():
        raise sqlite3.OperationalError("database or disk is full")

    with pytest.raises(StorageError, match="disk is full"), library.database.write():
        try:
            full()
        except sqlite3.OperationalError as error:
            raise OperationalError("INSERT", None, error) from error


@pytest.mark.parametrize("content", [b"not a database" * 100, b"SQLite format 3\0" + bytes(5000)])
def test_a_damaged_database_is_an_error_in_words(tmp_path, content):
    library = open_library(tmp_path)
    library.database.close()
    (library.inner / "library.db").write_bytes(content)
    with pytest.raises(StorageError, match="damaged") as caught:
        open_library(tmp_path)
    assert "expmap restore" in caught.value.hint


def test_a_database_that_was_emptied_is_not_taken_for_a_new_one(tmp_path):
    library = open_library(tmp_path)
    library.database.close()
    (library.inner / "library.db").write_bytes(b"")
    open_library(tmp_path).database.close()
    (library.inner / "library.db").write_bytes(b"")
    (tmp_path / "park").mkdir()
    with pytest.raises(StorageError, match="is empty"):
        open_library(tmp_path)


def test_what_breaks_a_rule_of_the_database_stays_a_bug(library, new_account):
    new_account("ana")
    with pytest.raises(IntegrityError), library.database.write() as session:
        session.add(Account(id=1, name="bob"))


@pytest.mark.usefixtures("sqlite_only")
def test_a_database_that_turns_read_only_while_it_is_open_is_an_error_in_words(library, new_account):
    """As a disk does after an error; data can still be read, and later written again."""

    def refuse(connection):
        connection.exec_driver_sql("PRAGMA query_only=ON")

    event.listen(library.database.engine, "begin", refuse)
    with (
        pytest.raises(DatabaseUnavailable, match="the database is read-only") as caught,
        library.database.write() as session,
    ):
        session.add(Account(name="Eva", is_owner=False))
    assert "administrator" in caught.value.hint
    with library.database.read() as session:
        assert session.query(Account).count() == 0
    event.remove(library.database.engine, "begin", refuse)
    library.database.close()
    new_account("Eva")
