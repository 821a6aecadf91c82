"""Helpers to move a library and compare its databases."""

from datetime import UTC, datetime

from webapp.errors import StorageError
from webapp.progress import Progress
from webapp.store.database import Database
from webapp.store.library import DATABASE, open_library
from webapp.store.moving.copying import copy_records, prepare
from webapp.store.schema import QueryRecord
from webapp.tasks.operate.move import move_to_file, move_to_server

ZERO_AT_THE_END = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def new_query(name):
    return QueryRecord(
        map_id=1, name=name, file="q.jpg", width=4, height=3, options={}, evidence=[],
        answer={"z": 1, "a": [1e-300, None, "\u00fc\u0000"]},
    )  # fmt: skip


def file_url(folder):
    return f"sqlite:///{folder / '.library' / DATABASE}"


def hashes(url, tmp_path):
    """Return the number of rows and the hash of each table."""
    source, copy = Database(url), Database(f"sqlite:///{tmp_path / 'compared.db'}")
    try:
        prepare(copy, key="a", again=True)
        with source.moving() as connection:
            return copy_records(connection, copy, progress=Progress())
    finally:
        source.close()
        copy.close()


def to_server(folder, url, progress=None):
    return move_to_server(folder, url, progress=progress or Progress())


def to_file(folder, url, progress=None):
    return move_to_file(folder, url, progress=progress or Progress())


def opens(folder, url):
    """Return whether a library can be opened."""
    try:
        open_library(folder, url=url).database.close()
    except StorageError:
        return False
    return True


class Stop(Exception):
    pass


class StopAt(Progress):
    """Stops a move at a table."""

    def __init__(self, table):
        self._table = table

    def note(self, text):
        if text.endswith(f" {self._table}"):
            raise Stop
