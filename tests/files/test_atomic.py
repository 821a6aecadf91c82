"""Files are written completely or not at all."""

import errno
import os
import stat
import sys
from pathlib import Path

import pytest

from webapp.errors import StorageError
from webapp.files import atomic


def test_new_and_replaced_content(tmp_path: Path) -> None:
    path = tmp_path / "map.cfg"
    atomic.write_text(path, "ž\r\n")
    assert path.read_bytes() == b"\xc5\xbe\r\n"
    atomic.write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="permissions are POSIX")
def test_permissions_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "map.cfg"
    path.write_bytes(b"old")
    path.chmod(0o640)
    atomic.write_bytes(path, b"new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.parametrize(
    ("code", "hint"),
    [(errno.ENOSPC, "free some space"), (errno.EROFS, "read-only"), (errno.EACCES, "may write")],
)
def test_disk_error_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, hint: str
) -> None:
    path = tmp_path / "map.cfg"
    path.write_bytes(b"old")

    def refuse(handle: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(StorageError) as caught:
        atomic.write_bytes(path, b"new")
    assert hint in str(caught.value.hint) and str(path) == caught.value.where
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_killed_before_the_rename_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "map.cfg"
    path.write_bytes(b"old")

    def interrupt(self: Path, target: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        atomic.write_bytes(path, b"new")
    assert path.read_bytes() == b"old"


def test_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="create the folder"):
        atomic.write_bytes(tmp_path / "none" / "map.cfg", b"x")
