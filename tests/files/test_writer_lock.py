"""A single writer at a time, also after one was killed."""

import errno
import subprocess
import sys

import pytest

from webapp.errors import FolderInUse, StorageError
from webapp.files.lock import allow_open_files, writer_lock

HOLD = """
import sys, time
from pathlib import Path
from webapp.files.lock import writer_lock
with writer_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_writer_is_reported_and_a_killed_one_leaves_no_lock(tmp_path):
    folder = tmp_path / "index"
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(FolderInUse, match="another process is building") as refused, writer_lock(folder):
            pass
        assert refused.value.where == str(folder)
        assert refused.value.hint is not None
        other.kill()
        other.wait()
        with writer_lock(folder, wait_s=5.0):
            pass


def test_it_can_be_taken_again_and_again_also_after_an_error(tmp_path):
    for _ in range(3):
        with pytest.raises(ZeroDivisionError), writer_lock(tmp_path):
            1 / 0  # noqa: B018
    with writer_lock(tmp_path):
        pass


def test_a_folder_that_cannot_be_made_is_a_storage_error(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="--index FOLDER"), writer_lock(tmp_path / "file" / "index"):
        pass


def test_a_folder_that_cannot_be_written_is_a_storage_error(tmp_path, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("filelock.FileLock.acquire", refuse)
    with pytest.raises(StorageError, match="Read-only"), writer_lock(tmp_path):
        pass


def test_as_many_files_may_be_open_as_locks_are_held():
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (512, hard))
        allow_open_files(400)
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (512, hard)
        allow_open_files(600)
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (600, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
