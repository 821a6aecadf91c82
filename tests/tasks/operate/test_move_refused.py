"""An impossible move is refused with a message, and the library stays unchanged."""

import pytest
from filelock import FileLock
from sqlalchemy import text

from tests.tasks.operate.moves import opens, to_file, to_server
from webapp.errors import Busy, Conflict, DatabaseUnavailable, DiskFull, NotFound, StorageError, UsageError
from webapp.jobs.health import ProcessLock
from webapp.store.backends.sqlite import Sqlite
from webapp.store.database import Database
from webapp.store.library import MOVING, open_library
from webapp.store.schema import Account, MapRecord
from webapp.tasks.operate import move


def test_nobody_else_may_use_the_library(folder, server, monkeypatch, tmp_path):
    monkeypatch.setattr(move, "_WAIT_S", 0.2)
    url = server()
    worker = ProcessLock(folder / ".library" / "workers")
    with pytest.raises(Conflict, match="stop them first"):
        to_server(folder, url)
    worker.release()
    stale = open_library(folder)
    with pytest.raises(Conflict, match="stop them first"), stale.database.read() as session:
        session.query(Account).count()
        to_server(folder, url)
    stale.database.close()
    with FileLock(folder / ".library" / MOVING):
        with pytest.raises(Busy, match="being moved already"):
            to_server(folder, url)
        with pytest.raises(StorageError, match="being moved"):
            open_library(folder)
    to_server(folder, url)
    other = open_library(folder, url=url)
    with pytest.raises(Conflict, match="stop them first"):
        to_file(folder, url)
    other.database.close()
    to_file(folder, url)


def test_what_cannot_be_moved_is_refused_and_stays(folder, server, tmp_path, monkeypatch):
    url = server()
    with pytest.raises(NotFound, match="no library"):
        to_server(tmp_path / "nowhere", url)
    with pytest.raises(DatabaseUnavailable, match="cannot be reached"):
        to_server(folder, "postgresql+psycopg://nobody@127.0.0.1:1/none")
    with pytest.raises(UsageError, match="in SQLite already"):
        to_file(folder, url)
    other = Database(url)
    with other.engine.begin() as connection:
        connection.execute(text("CREATE TABLE theirs (id integer)"))
    other.close()
    with pytest.raises(UsageError, match="not empty"):
        to_server(folder, url)
    monkeypatch.setattr(move, "newest_schema", lambda: "9999")
    with pytest.raises(StorageError, match="another version"):
        to_server(folder, server())
    monkeypatch.undo()
    assert opens(folder, None)
    to_server(folder, url := server())
    with pytest.raises(UsageError, match="address of the database is needed"):
        to_file(folder, None)
    assert opens(folder, url)


def test_a_value_that_the_server_cannot_hold_is_named(folder, server):
    library = open_library(folder)
    with library.database.write() as session:
        session.get_one(MapRecord, 1).revision = 2**40
    library.database.close()
    with pytest.raises(StorageError, match=r"table map: the database rejected rows.*out of range"):
        to_server(folder, server())
    assert opens(folder, None)


def test_a_full_disk_leaves_the_library_as_it_was(folder, server, monkeypatch):
    to_server(folder, url := server())
    with monkeypatch.context() as patched:
        insert_rows = Sqlite.insert

        def insert_some(self, connection, table, **rows):
            connection.exec_driver_sql("PRAGMA max_page_count = 100")
            insert_rows(self, connection, table, **rows)

        patched.setattr(Sqlite, "insert", insert_some)
        with pytest.raises(DiskFull):
            to_file(folder, url)
    assert opens(folder, url)
    to_file(folder, url)
