"""Building resumes after a stop, a full disk, damage, and many changes."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from webapp.errors import Cancelled, StorageError
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.files.lock import writer_lock
from webapp.jobs.context import JobProgress
from webapp.progress import Progress
from webapp.tasks.localize import segments


class CancelAfter(Progress):
    """Stops the work after a number of photos."""

    def __init__(self, photos: int) -> None:
        self.left = photos

    def advance(self, steps: int = 1) -> None:
        self.left -= steps

    def cancelled(self) -> bool:
        return self.left <= 0


class Notes(Progress):
    """Records the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_cancelled_build_keeps_what_was_finished(tmp_path, make_map, build, jobs, lasting):
    cfg = make_map(tmp_path, 24)
    whole = build(cfg, index=tmp_path / "whole")
    with pytest.raises(Cancelled):
        build(cfg, jobs=jobs, progress=CancelAfter(5))
    (spool,) = tmp_path.glob("derived/map/*/spool")
    kept = len([p for p in spool.iterdir() if p.suffix == ".features"])
    assert 5 <= kept < 24
    rest = JobProgress()
    report = build(cfg, progress=rest)
    assert report.extracted == 24 - kept
    assert report.reused == kept
    assert rest.state()[:2] == (24 - kept, 24 - kept)  # its pace is that of the photos that are left
    assert lasting(report.folder) == lasting(whole.folder)


def test_stopped_while_joining(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 5)
    with pytest.raises(Cancelled):
        build(cfg, progress=CancelAfter(5))
    assert len(described) == 5
    report = build(cfg)
    assert (report.extracted, report.reused, len(described)) == (0, 5, 5)


def test_stale_temporary_files_are_swept(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 3)
    folder = build(cfg).folder
    for name in (".manifest.json.ab12.tmp", ".0a.features.ab12.tmp", "spool/.0b.features.cd34.tmp"):
        (folder / name).write_bytes(b"half")
    build(cfg)
    assert not [p for p in folder.rglob("*") if p.suffix == ".tmp"]


def test_a_full_disk_is_reported_and_nothing_is_lost(tmp_path, make_map, build, monkeypatch):
    cfg = make_map(tmp_path, 6)
    sync, calls = os.fsync, []

    def full(handle):
        calls.append(handle)
        if len(calls) > 5:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    with monkeypatch.context() as patch, pytest.raises(StorageError, match="free some space"):
        patch.setattr(os, "fsync", full)
        build(cfg)
    report = build(cfg)
    assert report.failed == ()
    assert 0 < report.reused < 6


def test_a_folder_that_cannot_be_made_is_reported(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 2)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="--index FOLDER"):
        build(cfg, index=tmp_path / "file")


def test_a_second_builder_is_reported(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 2)
    folder = build(cfg).folder
    with writer_lock(folder), pytest.raises(StorageError, match="another process is building"):
        build(cfg)


def damage_segment(folder: Path) -> None:
    path = next(folder.glob("*.features"))
    path.write_bytes(path.read_bytes()[:-100])


def delete(pattern: str):
    def run(folder: Path) -> None:
        for path in folder.glob(pattern):
            path.unlink()

    run.__name__ = f"delete {pattern}"
    return run


def cut(pattern: str):
    def run(folder: Path) -> None:
        for path in folder.glob(pattern):
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    run.__name__ = f"cut {pattern}"
    return run


def flip(pattern: str):
    """Change one bit in the middle of each file."""

    def run(folder: Path) -> None:
        for path in folder.glob(pattern):
            data = bytearray(path.read_bytes())
            data[len(data) // 2] ^= 1
            path.write_bytes(data)

    run.__name__ = f"flip {pattern}"
    return run


DAMAGES = [
    damage_segment,
    delete("*.features"),
    delete("*.ivf"),
    delete("*.codebook"),
    delete("manifest.json"),
]
DAMAGES += [cut("*.features"), cut("*.ivf"), cut("*.codebook"), cut("manifest.json"), delete("*.*")]
DAMAGES += [flip("*.features"), flip("*.ivf"), flip("*.codebook"), flip("manifest.json")]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__)
@pytest.mark.parametrize("features", ["sift", "orb"])
def test_a_damaged_index_is_mended(tmp_path, make_map, build, damage, features, lasting):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg, features=features).folder
    whole = lasting(folder)
    damage(folder)
    result = Notes()
    report = build(cfg, features=features, progress=result)
    assert report.failed == ()
    assert lasting(folder) == whole
    if (folder / "manifest.json").exists() and damage.__name__ not in ("delete manifest.json", "delete *.*"):
        assert any("rebuilding" in note for note in result.notes)
    assert build(cfg, features=features).extracted == 0


def test_only_the_photos_of_a_damaged_segment_are_computed(
    tmp_path, make_map, save_photo, build, described, lasting, edit
):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg).folder
    (first,) = folder.glob("*.features")
    save_photo(tmp_path / "photos" / "new.jpg", 77)
    edit(cfg, lambda lines: lines.append("42;photos/new.jpg;50;50"))
    build(cfg)
    whole = lasting(folder)
    (second,) = {*folder.glob("*.features")} - {first}
    described.clear()
    second.write_bytes(b"")
    build(cfg)
    assert described == ["new.jpg"]
    assert lasting(folder) == whole


def test_a_damaged_finished_photo_is_computed_again(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 6)
    with pytest.raises(Cancelled):
        build(cfg, progress=CancelAfter(4))
    spool = sorted(tmp_path.glob("derived/map/*/spool/*"))
    assert len(spool) == 4
    spool[0].write_bytes(spool[0].read_bytes()[:700])
    described.clear()
    report = build(cfg)
    assert (report.extracted, report.reused, len(described)) == (3, 3, 3)


def test_many_small_additions_are_joined(tmp_path, make_map, build, described, found):
    cfg = make_map(tmp_path, 24)
    lines = cfg.read_text().splitlines(keepends=True)
    counts = []
    for photos in range(1, 25):
        cfg.write_text("".join(lines[: photos + 1]))
        report = build(cfg)
        assert report.extracted == 1
        manifest = IndexFolder(report.folder).read_manifest()
        assert sum(s.photos for s in manifest.segments) == photos
        counts.append(len(manifest.segments))
    assert max(counts) <= segments._MOST_SMALL + 2
    assert counts[-1] < 24
    assert len(described) == 24
    assert all(found(cfg, tmp_path / "photos" / f"{i}.jpg")[0] == (i, 1.0) for i in (0, 11, 23))


def test_full_segments_stay_when_small_ones_are_joined(tmp_path, make_map, build, monkeypatch):
    monkeypatch.setattr(segments, "PHOTOS_PER_SEGMENT", 4)
    monkeypatch.setattr(segments, "_MOST_SMALL", 2)
    cfg = make_map(tmp_path, 12)
    lines = cfg.read_text().splitlines(keepends=True)
    cfg.write_text("".join(lines[:9]))
    folder = IndexFolder(build(cfg).folder)
    full = [s.name for s in folder.read_manifest().segments]
    assert len(full) == 2
    for photos in (9, 10, 11, 12):
        cfg.write_text("".join(lines[: photos + 1]))
        build(cfg)
        now = folder.read_manifest().segments
        assert [s.name for s in now[:2]] == full
        assert sum(s.photos for s in now) == photos
    assert [s.photos for s in now] == [4, 4, 4]


def test_a_segment_with_much_that_is_gone_is_rewritten(tmp_path, make_map, build, described, edit):
    cfg = make_map(tmp_path, 10)
    folder = build(cfg).folder
    described.clear()
    edit(cfg, lambda lines: lines.__delitem__(slice(2, 6)))
    report = build(cfg)
    assert (report.removed, report.extracted, described) == (4, 0, [])
    (segment,) = folder.glob("*.features")
    assert len(read_segment(segment).content) == 6
    assert report.descriptors == len(read_segment(segment).xy)


def test_a_map_that_has_grown_much_is_partitioned_again(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 12)
    lines = cfg.read_text().splitlines(keepends=True)
    cfg.write_text("".join(lines[:3]))
    folder = IndexFolder(build(cfg).folder)
    before = folder.read_manifest()
    cfg.write_text("".join(lines))
    report = build(cfg)
    after = folder.read_manifest()
    assert report.extracted == 10
    assert after.codebook != before.codebook
    assert after.trained_for == report.descriptors
    assert after.segments[0].name == before.segments[0].name
    assert len(list(folder.folder.glob("*.codebook"))) == 1
    assert len(list(folder.folder.glob("*.ivf"))) == len(after.segments)


def test_a_map_without_any_texture_is_built(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 2)
    for number in range(2):
        path = tmp_path / "photos" / f"{number}.jpg"
        cv2.imwrite(str(path), cv2.imread(str(path)) // 255)
    report = build(cfg)
    assert (report.photos, report.descriptors, report.failed) == (2, 0, ())
    assert build(cfg).extracted == 0


def test_a_map_without_photos_is_built(tmp_path, make_map, build):
    report = build(make_map(tmp_path, 0))
    assert (report.photos, report.descriptors) == (0, 0)


FEW_FILES = """
import resource, sys
from pathlib import Path
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.localize import build_map
from webapp.tasks.localize.plan import OpenOptions
resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))
settings = Settings(extract=ExtractSettings(max_side_px=320, keypoints=20))
asked = OpenOptions(method="vote", jobs=1)
report = build_map.build_map(Path(sys.argv[1]), asked, settings=settings, progress=Progress())
print(report.index.extracted, len(report.index.failed))
"""


def test_few_files_are_open_at_a_time(tmp_path, make_map):
    cfg = make_map(tmp_path, 60)
    done = subprocess.run(
        [sys.executable, "-c", FEW_FILES, str(cfg)], capture_output=True, text=True, timeout=300
    )
    assert done.stdout == "60 0\n", done.stderr
