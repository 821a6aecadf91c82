"""Bytes of an upload are in order and on disk, or not stored."""

import errno
import io
import os
import shutil
import threading

import pytest

from webapp.errors import DiskFull, InputError, StorageError, TableError
from webapp.files import part_file
from webapp.files.part_file import (
    WrongOffset,
    append,
    arrived,
    check_space,
    move_in,
    one_at_a_time,
    receive,
    show_file_as,
)


def test_chunks_in_order(tmp_path):
    part = tmp_path / "a.part"
    assert arrived(part) == 0
    assert append(part, b"abc", offset=0, size=5) == 3
    assert append(part, b"", offset=3, size=5) == 3
    with pytest.raises(WrongOffset) as caught:
        append(part, b"x", offset=2, size=5)
    assert caught.value.offset == 3
    with pytest.raises(InputError, match="beyond the 5 bytes"):
        append(part, b"def", offset=3, size=5)
    assert append(part, b"de", offset=3, size=5) == 5
    assert part.read_bytes() == b"abcde"


def full(*_positional):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_piece_that_did_not_fit_on_the_disk_leaves_no_trace(tmp_path, monkeypatch):
    part = tmp_path / "a.part"
    append(part, b"abc", offset=0, size=9)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(DiskFull, match="No space left"):
            append(part, b"def", offset=3, size=9)
    assert part.read_bytes() == b"abc"
    assert append(part, b"def", offset=3, size=9) == 6


def test_a_stream_is_there_whole_or_not_at_all(tmp_path, monkeypatch):
    part = tmp_path / "a.part"
    assert receive(part, io.BytesIO(b"x" * 3000), max_bytes=3000) == 3000
    assert part.stat().st_size == 3000
    for limit, patched, kind in ((2999, None, InputError), (9999, full, DiskFull)):
        with monkeypatch.context() as patch:
            if patched:
                patch.setattr(os, "fsync", patched)
            with pytest.raises(kind):
                receive(tmp_path / "b.part", io.BytesIO(b"x" * 3000), max_bytes=limit)
        assert not (tmp_path / "b.part").exists()


def test_a_folder_that_is_gone_is_reported(tmp_path):
    with pytest.raises(StorageError):
        append(tmp_path / "gone" / "a.part", b"x", offset=0, size=1)


def test_a_file_that_cannot_move_stays(tmp_path, monkeypatch):
    source, target = tmp_path / "a", tmp_path / "new" / "deep" / "b"
    source.write_bytes(b"abc")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(DiskFull):
            move_in(source, target)
    assert source.exists() and not target.exists()
    move_in(source, target)
    assert (source.exists(), target.read_bytes()) == (False, b"abc")


def test_a_file_larger_than_the_disk_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(100, 0, 50_000_000))
    check_space(tmp_path, 10_000_000, reserve_mb=40)
    with pytest.raises(DiskFull, match="11 MB are needed, and the disk has 50 MB left"):
        check_space(tmp_path, 11_000_000, reserve_mb=40)


def test_one_works_on_an_upload_at_a_time(tmp_path):
    part, busy, most = tmp_path / "ab.part", [], []

    def work():
        with one_at_a_time(part):
            busy.append(1)
            most.append(len(busy))
            append(part, b"x", offset=arrived(part), size=99)
            busy.pop()

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (max(most), arrived(part)) == (1, 8)


def test_a_busy_upload_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(part_file, "_WAIT_S", 0.01)
    with one_at_a_time(tmp_path / "ab.part"), pytest.raises(part_file.Conflict, match="busy"):  # noqa: SIM117
        with one_at_a_time(tmp_path / "ab.part"):
            pass


def test_errors_name_a_file_as_its_sender_does(tmp_path):
    path = tmp_path / "0123.csv"
    for where, result in ((f"{path}:3", "list.csv:3"), (None, "list.csv"), (str(path), "list.csv")):
        with pytest.raises(TableError) as caught, show_file_as("list.csv", path):
            raise TableError(f"{path} is bad", where=where)
        assert (caught.value.where, caught.value.message) == (result, "list.csv is bad")
    with pytest.raises(TableError) as caught, show_file_as("list.csv"):
        raise TableError("bad")
    assert caught.value.where == "list.csv"
