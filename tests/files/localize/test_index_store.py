"""The manifest, the files it names, and search indexes on disk."""

import errno
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from webapp.core.features.table import choose
from webapp.core.retrieval.engines import ivf, types
from webapp.errors import IndexDamaged, StorageError
from webapp.files.localize.index_store import (
    FORMAT,
    IndexFolder,
    Manifest,
    PhotoRecord,
    SegmentRecord,
    index_key,
    read_search_index,
    remove_outdated,
    write_search_index,
)
from webapp.files.sealed import sealed
from webapp.settings import ExtractSettings

MANIFEST = Manifest(
    detector="sift",
    extractor="sift",
    extract=ExtractSettings(),
    codebook="c0de",
    trained_for=900,
    segments=(SegmentRecord("aa", 2, 900, "bb"), SegmentRecord("cc", 1, 0, "dd")),
    photos={0: PhotoRecord("p/ž 0.jpg", 10, 20, "ff"), 7: PhotoRecord("p/7.jpg", 0, 0, "", "missing")},
    build_seconds=1.5,
)


@pytest.fixture
def index(tmp_path):
    folder = IndexFolder(tmp_path / "sift-1")
    folder.spool.mkdir(parents=True)
    return folder


def test_a_manifest_comes_back(index):
    assert index.read_manifest() is None
    index.write_manifest(MANIFEST)
    assert index.read_manifest() == MANIFEST


def remove_field(raw):
    del raw["segments"][0]["codes"]


@pytest.mark.parametrize(
    "change",
    [
        lambda raw: raw.pop("photos"),
        lambda raw: raw.update(photos=[]),
        lambda raw: raw.update(photos={"x": {}}),
        lambda raw: raw.update(segments=7),
        lambda raw: raw.update(extract={"colour": 1}),
        lambda raw: raw.update(extract=None),
        lambda raw: raw.pop("format"),
        remove_field,
    ],
)
def test_wrong_fields_are_damage(index, change):
    index.write_manifest(MANIFEST)
    raw = json.loads(index.manifest_path.read_text())
    change(raw)
    del raw["check"]
    index.manifest_path.write_text(json.dumps(raw))
    with pytest.raises(IndexDamaged, match="manifest") as damaged:
        index.read_manifest()
    assert "expmap build" in str(damaged.value.hint)


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "null", "\x00\x01"])
def test_another_file_is_damage(index, text):
    index.manifest_path.write_text(text)
    with pytest.raises(IndexDamaged, match="manifest"):
        index.read_manifest()


def test_another_format_is_reported(index):
    index.write_manifest(MANIFEST)
    raw = json.loads(index.manifest_path.read_text()) | {"format": 99}
    index.manifest_path.write_bytes(sealed(raw))
    with pytest.raises(IndexDamaged, match="format 99"):
        index.read_manifest()


def test_a_manifest_of_an_older_program_is_read(index):
    index.write_manifest(MANIFEST)
    raw = json.loads(index.manifest_path.read_text())
    del raw["check"]
    index.manifest_path.write_text(json.dumps(raw))
    assert index.read_manifest() == MANIFEST


def test_any_changed_byte_of_a_manifest_is_damage(index):
    index.write_manifest(MANIFEST)
    data = index.manifest_path.read_bytes()
    for place in range(len(data)):
        index.manifest_path.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        try:
            assert index.read_manifest() == MANIFEST, place
        except IndexDamaged as damaged:
            assert damaged.hint


def test_only_what_the_manifest_does_not_name_is_removed(index):
    named = ["c0de.codebook", "aa.features", "aa-c0de.ivf", "cc.features", "cc-c0de.ivf"]
    kept = ["manifest.json", "lock", "calibration-verified-ivf.json", "notes.txt"]
    stale = ["ee.features", "aa-old.ivf", "old.codebook", ".aa.features.12ab.tmp", ".manifest.json.9.tmp"]
    spool = ["spool/ff.features", "spool/.ff.features.77.tmp"]
    for name in [*named, *kept, *stale, *spool]:
        (index.folder / name).write_bytes(b"x")
    index.remove_unnamed(MANIFEST)
    left = {p.relative_to(index.folder).as_posix() for p in index.folder.rglob("*") if p.is_file()}
    assert left == {*named, *kept}


def test_a_file_that_cannot_be_removed_now_is_left_for_the_next_time(index, monkeypatch):
    (index.folder / "ee.features").write_bytes(b"x")

    def refuse(self, missing_ok=False):
        raise PermissionError(errno.EACCES, "in use")

    monkeypatch.setattr(Path, "unlink", refuse)
    index.remove_unnamed(MANIFEST)
    assert (index.folder / "ee.features").exists()


def test_a_broken_disk_is_reported_while_tidying(index, monkeypatch):
    (index.folder / "ee.features").write_bytes(b"x")

    def fail(self, missing_ok=False):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "unlink", fail)
    with pytest.raises(StorageError, match="cleaned up"):
        index.remove_unnamed(MANIFEST)


def test_bytes_on_disk_counts_every_file(index):
    (index.folder / "a").write_bytes(bytes(100))
    (index.spool / "b").write_bytes(bytes(11))
    assert index.bytes_on_disk() == 111


def test_a_file_that_vanishes_while_counting_is_no_error(index, monkeypatch):
    (index.folder / "a").write_bytes(bytes(100))
    monkeypatch.setattr(Path, "rglob", lambda self, _: iter([self / "a", self / "gone"]))
    monkeypatch.setattr(Path, "is_file", lambda self: True)
    assert index.bytes_on_disk() == 100


def test_the_key_depends_on_what_is_computed_and_not_on_how_it_is_matched():
    sift = choose("verified", features="sift")
    extract = ExtractSettings()
    assert index_key(sift, extract) == index_key(choose("vote", features="sift", matcher="l1"), extract)
    keys = {
        index_key(choice, extract)
        for choice in (sift, choose("vote", features="sift-plain"), choose("vote", features="orb"))
    }
    keys |= {
        index_key(sift, replace(extract, keypoints=500)),
        index_key(sift, replace(extract, max_side_px=640)),
        index_key(choose("vote", detector="orb", extractor="sift"), extract),
    }
    keys |= {index_key(replace(sift, weights=weights), extract) for weights in ("5a", "5b")}
    assert len(keys) == 8
    assert index_key(sift, extract).startswith("sift-")


def trained(kind):
    width = 32 if kind == "binary" else 128
    rows = np.random.default_rng(0).integers(0, 256, (900, width), np.uint8)
    index = ivf.train(rows, len(rows), kind=kind)
    ivf.encode(index, rows)
    return index, rows


@pytest.mark.parametrize("mapped", [True, False])
@pytest.mark.parametrize("kind", ["float", "binary"])
def test_a_search_index_answers_the_same_from_disk(tmp_path, kind, mapped):
    index, rows = trained(kind)
    digest = write_search_index(tmp_path / "{hash}.ivf", index, kind=kind)
    read = read_search_index(tmp_path / f"{digest}.ivf", kind, mapped=mapped)
    assert read.ntotal == 900
    before, after = ivf.InvertedFile([index]).search(rows, 3), ivf.InvertedFile([read]).search(rows, 3)
    assert np.array_equal(before.distance, after.distance)
    assert np.array_equal(before.row[:, 0], after.row[:, 0])


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
@pytest.mark.parametrize("kind", ["float", "binary"])
def test_a_cut_search_index_is_damaged(tmp_path, kind, share):
    path = tmp_path / "a.ivf"
    write_search_index(path, trained(kind)[0], kind=kind)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(IndexDamaged, match="expmap build") as damaged:
        read_search_index(path, kind)
    assert damaged.value.where == str(path)


@pytest.mark.parametrize("kind", ["float", "binary"])
def test_a_missing_or_other_search_index_is_damaged(tmp_path, kind):
    with pytest.raises(IndexDamaged):
        read_search_index(tmp_path / "none", kind)
    (tmp_path / "other").write_bytes(b"\x89PNG" * 400)
    with pytest.raises(IndexDamaged):
        read_search_index(tmp_path / "other", kind)


@pytest.mark.skipif(sys.platform != "linux", reason="asks the kernel what is mapped")
@pytest.mark.parametrize("compressed", [True, False])
def test_codes_are_in_memory_once(tmp_path, monkeypatch, compressed):
    monkeypatch.setattr(types, "_WHOLE_BELOW", 0 if compressed else 10_000)
    index, rows = trained("float")
    path = tmp_path / "once.ivf"
    write_search_index(path, index, kind="float")
    read = read_search_index(path, "float")
    # Faiss copies 4-bit codes: memory-mapped, they would exist twice.
    assert (str(path) in Path("/proc/self/maps").read_text()) != compressed
    assert read.ntotal == len(rows)


def test_indexes_of_older_programs_are_removed_and_no_others(tmp_path):
    for name, text in {
        "older": json.dumps({"format": FORMAT - 1}),
        "mine": json.dumps({"format": FORMAT}),
        "newer": json.dumps({"format": FORMAT + 1}),
        "damaged": "{",
        "odd": json.dumps({"format": "old"}),
        "list": "[]",
    }.items():
        (tmp_path / name / "spool").mkdir(parents=True)
        (tmp_path / name / "manifest.json").write_text(text)
    (tmp_path / "photos").mkdir()
    remove_outdated(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "mine",
        "newer",
        "damaged",
        "odd",
        "list",
        "photos",
    }
