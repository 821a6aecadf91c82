"""A backup of a library in SQLite or in PostgreSQL is restored into either."""

import shutil

import pytest

from tests.tasks.operate.moves import Stop, file_url, hashes, opens, to_server
from webapp.app.registry import LIBRARY_PARTS
from webapp.errors import StorageError, UsageError
from webapp.progress import Progress
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.schema import Account
from webapp.tasks.operate import backup


def new_account(library):
    """Make an account and return its id."""
    with library.database.write() as session:
        return accounts.create(session, "eva").id


@pytest.mark.parametrize("made_on", ["sqlite", "postgresql"])
def test_a_backup_of_either_is_restored_into_either(folder, server, made_on, tmp_path):
    url = None
    before = {copy for copy in hashes(file_url(folder), tmp_path) if copy.name != "job"}
    if made_on == "postgresql":
        to_server(folder, url := server())
    library = open_library(folder, url=url)
    deleted = new_account(library)
    with library.database.write() as session:
        session.delete(session.get_one(Account, deleted))
    report = backup.back_up(library, tmp_path / "a.zip", parts=LIBRARY_PARTS, progress=Progress())
    library.database.close()
    assert (report.maps, report.photos) == (1, 3)
    backup.restore(tmp_path / "a.zip", tmp_path / "file", parts=LIBRARY_PARTS, progress=Progress())
    assert opens(tmp_path / "file", None)
    assert before <= set(hashes(file_url(tmp_path / "file"), tmp_path))
    into = server()
    restored = tmp_path / "server"
    backup.restore(tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, progress=Progress())
    assert before <= set(hashes(into, tmp_path))
    assert opens(restored, into)
    for place, address in ((tmp_path / "file", None), (restored, into)):
        library = open_library(place, url=address)
        assert new_account(library) == deleted + 1
        library.database.close()
    assert (restored / "park" / "map.cfg").read_bytes() == (folder / "park" / "map.cfg").read_bytes()
    with pytest.raises(UsageError, match="not empty"):
        backup.restore(
            tmp_path / "a.zip", tmp_path / "more", parts=LIBRARY_PARTS, url=into, progress=Progress()
        )


def test_a_restore_into_a_server_that_was_stopped_begins_anew(folder, server, tmp_path, monkeypatch):
    library = open_library(folder)
    backup.back_up(library, tmp_path / "a.zip", parts=LIBRARY_PARTS, progress=Progress())
    library.database.close()
    into, restored = server(), tmp_path / "restored"

    def fail(*args):
        raise Stop

    with monkeypatch.context() as patched:
        patched.setattr(backup, "_swap", fail)
        with pytest.raises(Stop):
            backup.restore(tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, progress=Progress())
    with pytest.raises(StorageError, match="has not finished"):
        open_library(restored, url=into)
    shutil.rmtree(restored)
    backup.restore(tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, progress=Progress())
    assert opens(restored, into)


def test_a_restore_that_was_stopped_after_the_files_were_placed_says_how_to_go_on(
    folder, server, tmp_path, monkeypatch
):
    library = open_library(folder)
    backup.back_up(library, tmp_path / "a.zip", parts=LIBRARY_PARTS, progress=Progress())
    library.database.close()
    into, restored = server(), tmp_path / "restored"

    def fail(*args):
        raise Stop

    with monkeypatch.context() as patched:
        patched.setattr(backup.marks, "unmark_filling", fail)
        with pytest.raises(Stop):
            backup.restore(tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, progress=Progress())
    with pytest.raises(UsageError, match="stopped just before its end: repeat it with --force"):
        backup.restore(tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, progress=Progress())
    backup.restore(
        tmp_path / "a.zip", restored, parts=LIBRARY_PARTS, url=into, force=True, progress=Progress()
    )
    assert opens(restored, into)
