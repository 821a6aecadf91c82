"""Building: only what changed is computed, nothing is lost, nothing is wrong."""

import errno
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from webapp.errors import Cancelled, StorageError
from webapp.files.featurefile import read_segment
from webapp.files.indexstore import IndexFolder
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks import extract_photo, segments
from webapp.tasks.localize_photo import PhotoLocalizer
from webapp.tasks.open_map import OpenOptions
from webapp.tasks.open_map import run as open_map


class CancelAfter(Progress):
    """Stops the work after so many photos."""

    def __init__(self, photos: int) -> None:
        self.left = photos

    def advance(self, steps: int = 1) -> None:
        self.left -= steps

    def cancelled(self) -> bool:
        return self.left <= 0


class Notes(Progress):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture
def described(monkeypatch) -> list[str]:
    """Names of the photos whose features are computed."""
    names = []
    describe = extract_photo._describe

    def note(data, content, job):
        names.append(Path(job.photo).name)
        return describe(data, content, job)

    monkeypatch.setattr(extract_photo, "_describe", note)
    return names


def files(folder: Path) -> dict[str, bytes]:
    """The lasting files of an index, without the manifest."""
    return {
        p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".features", ".ivf", ".codebook")
    }


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    return {p.name: (p.stat().st_mtime_ns, p.stat().st_ino) for p in folder.iterdir() if p.is_file()}


def edit(cfg: Path, change) -> None:
    lines = cfg.read_text().splitlines()
    change(lines)
    cfg.write_text("\n".join(lines) + "\n")


def found(cfg: Path, photo: Path, quick: Settings, **options) -> list[tuple[int, float]]:
    """Ids and probabilities that `vote` answers for a photo."""
    opened = open_map(cfg, OpenOptions(method="vote", jobs=1, **options), settings=quick, progress=Progress())
    answer = PhotoLocalizer(opened, quick).localize(photo, top=9)
    return [(h.experiences[0], h.probability) for h in answer.hypotheses]


def test_first_everything_then_nothing(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 6)
    first = build(cfg)
    assert (first.photos, first.extracted, first.reused, first.removed, first.failed) == (6, 6, 0, 0, ())
    assert described == [f"{i}.jpg" for i in range(6)]
    assert first.descriptors > 6 * 50
    assert first.folder == tmp_path / "derived" / "map" / first.folder.name
    assert first.bytes == sum(p.stat().st_size for p in first.folder.rglob("*") if p.is_file())
    assert not list((first.folder / "spool").iterdir())
    before, started = stamps(first.folder), time.perf_counter()
    again = build(cfg)
    assert time.perf_counter() - started < 2.0
    assert (again.photos, again.extracted, again.reused, again.removed) == (6, 0, 6, 0)
    assert again.descriptors == first.descriptors
    assert stamps(first.folder) == before
    assert len(described) == 6


def test_an_added_photo_costs_that_photo_only(tmp_path, make_map, save_photo, build, described, quick):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg).folder
    before = files(folder)
    described.clear()
    save_photo(tmp_path / "photos" / "new.jpg", 77)
    edit(cfg, lambda lines: lines.insert(3, "42;photos/new.jpg;50;50"))
    report = build(cfg)
    assert described == ["new.jpg"]
    assert (report.extracted, report.reused) == (1, 5)
    assert before.items() <= files(folder).items()
    assert found(cfg, tmp_path / "photos" / "new.jpg", quick)[0][0] == 42
    assert all(found(cfg, tmp_path / "photos" / f"{i}.jpg", quick)[0][0] == i for i in range(5))


def test_a_moved_photo_costs_nothing(tmp_path, make_map, build, described, quick):
    cfg = make_map(tmp_path, 4)
    folder = build(cfg).folder
    before = stamps(folder)
    described.clear()
    edit(cfg, lambda lines: lines.__setitem__(2, "1;photos/1.jpg;7;9"))
    report = build(cfg)
    assert (report.extracted, report.reused) == (0, 4)
    assert described == []
    assert stamps(folder) == before
    opened = open_map(cfg, OpenOptions(method="vote"), settings=quick, progress=Progress())
    best = PhotoLocalizer(opened, quick).localize(tmp_path / "photos" / "1.jpg", top=1).hypotheses[0]
    assert (best.position.x, best.position.y) == (7.0, 9.0)


@pytest.mark.parametrize("features", ["sift", "orb"])
def test_a_removed_photo_costs_nothing_and_never_answers(
    tmp_path, make_map, build, described, quick, features
):
    cfg = make_map(tmp_path, 6)
    first = build(cfg, features=features)
    before = files(first.folder)
    described.clear()
    edit(cfg, lambda lines: lines.pop(3))
    report = build(cfg, features=features)
    assert (report.photos, report.extracted, report.reused, report.removed) == (5, 0, 5, 1)
    assert report.descriptors < first.descriptors
    assert described == []
    assert files(first.folder) == before
    answers = found(cfg, tmp_path / "photos" / "2.jpg", quick, features=features)
    assert answers
    assert 2 not in [i for i, _ in answers]
    assert sum(p for _, p in answers) == pytest.approx(1.0)


def test_a_removed_photo_that_comes_back_is_found_again(tmp_path, make_map, build, quick):
    cfg = make_map(tmp_path, 5)
    whole = cfg.read_text()
    build(cfg)
    edit(cfg, lambda lines: lines.pop(3))
    build(cfg)
    cfg.write_text(whole)
    report = build(cfg)
    assert (report.photos, report.reused + report.extracted) == (5, 5)
    assert found(cfg, tmp_path / "photos" / "2.jpg", quick)[0] == (2, 1.0)


def test_a_changed_photo_is_computed_again(tmp_path, make_map, save_photo, build, described, quick):
    cfg = make_map(tmp_path, 4)
    old = tmp_path / "old.jpg"
    shutil.copy(tmp_path / "photos" / "2.jpg", old)
    build(cfg)
    described.clear()
    save_photo(tmp_path / "photos" / "2.jpg", 99)
    report = build(cfg)
    assert described == ["2.jpg"]
    assert (report.extracted, report.reused, report.removed) == (1, 3, 0)
    assert found(cfg, tmp_path / "photos" / "2.jpg", quick)[0] == (2, 1.0)
    assert found(cfg, old, quick)[0][1] < 1.0


def test_renamed_touched_and_exchanged_photos_are_read_but_not_computed(
    tmp_path, make_map, build, described, quick
):
    cfg = make_map(tmp_path, 4)
    folder = build(cfg).folder
    before = files(folder)
    described.clear()
    photos = tmp_path / "photos"
    (photos / "0.jpg").rename(photos / "zero.jpg")
    edit(cfg, lambda lines: lines.__setitem__(1, "0;photos/zero.jpg;100;100"))
    os.utime(photos / "1.jpg", (1, 1))
    (photos / "2.jpg").rename(photos / "x.jpg")
    (photos / "3.jpg").rename(photos / "2.jpg")
    (photos / "x.jpg").rename(photos / "3.jpg")
    report = build(cfg)
    assert described == []
    assert (report.extracted, report.reused) == (0, 4)
    assert files(folder) == before
    assert found(cfg, photos / "2.jpg", quick)[0] == (2, 1.0)
    assert found(cfg, photos / "zero.jpg", quick)[0] == (0, 1.0)


def test_a_copied_map_takes_its_index_along(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path / "here", 5)
    build(cfg)
    described.clear()
    shutil.copytree(tmp_path / "here", tmp_path / "there", copy_function=shutil.copyfile)
    report = build(tmp_path / "there" / "map.cfg")
    assert (report.extracted, report.reused, described) == (0, 5, [])


def test_two_maps_in_a_folder_do_not_disturb_each_other(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 5)
    other = tmp_path / "part.cfg"
    other.write_text("".join(cfg.read_text().splitlines(keepends=True)[:3]))
    build(cfg), build(other)
    described.clear()
    assert (build(cfg).photos, build(other).photos, described) == (5, 2, [])


def test_unusable_photos_are_told_and_the_others_built(tmp_path, make_map, build, described, quick):
    cfg = make_map(tmp_path / "map", 9)
    photos = tmp_path / "map" / "photos"
    (photos / "0.jpg").unlink()
    (photos / "1.jpg").write_bytes(b"")
    (photos / "2.jpg").write_bytes(b"not a photo")
    (photos / "3.jpg").write_bytes((photos / "3.jpg").read_bytes()[:3000])
    (photos / "4.jpg").unlink()
    (photos / "4.jpg").mkdir()
    (photos / "5.jpg").rename(tmp_path / "outside.jpg")
    (photos / "5.jpg").symlink_to(tmp_path / "outside.jpg")
    cv2.imwrite(str(photos / "6.jpg"), cv2.imread(str(photos / "6.jpg")) // 255)
    report = build(cfg)
    assert {i: photo for i, photo, _ in report.failed} == {i: f"photos/{i}.jpg" for i in range(6)}
    reason = {i: text for i, _, text in report.failed}
    assert "no such file" in reason[0]
    assert "empty" in reason[1]
    assert "not an image" in reason[2]
    assert "not a file" in reason[4]
    assert "leads out of the map's folder" in reason[5]
    assert str(tmp_path) not in " ".join(reason.values())
    assert (report.photos, report.extracted, report.reused) == (9, 3, 0)
    assert found(cfg, photos / "8.jpg", quick)[0] == (8, 1.0)
    described.clear()
    again = build(cfg)
    assert again.failed == report.failed
    assert described == ["2.jpg", "3.jpg"]  # a build tries again what failed


def test_a_repaired_photo_is_taken_up(tmp_path, make_map, save_photo, build):
    cfg = make_map(tmp_path, 3)
    (tmp_path / "photos" / "1.jpg").unlink()
    assert len(build(cfg).failed) == 1
    save_photo(tmp_path / "photos" / "1.jpg", 1)
    report = build(cfg)
    assert (report.failed, report.extracted, report.reused) == ((), 1, 2)


def test_a_photo_that_breaks_later_no_longer_answers(tmp_path, make_map, build, quick):
    cfg = make_map(tmp_path, 4)
    copy = tmp_path / "query.jpg"
    shutil.copy(tmp_path / "photos" / "1.jpg", copy)
    build(cfg)
    (tmp_path / "photos" / "1.jpg").unlink()
    report = build(cfg)
    assert [i for i, _, _ in report.failed] == [1]
    assert 1 not in [i for i, _ in found(cfg, copy, quick)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_one_photo_under_two_ids_is_held_once(tmp_path, make_map, build, quick, jobs):
    cfg = make_map(tmp_path, 6)
    shutil.copy(tmp_path / "photos" / "1.jpg", tmp_path / "photos" / "copy.jpg")
    edit(cfg, lambda lines: lines.extend(["50;photos/1.jpg;5;5", "51;photos/copy.jpg;6;6"]))
    report = build(cfg, jobs=jobs)
    assert (report.photos, report.failed) == (8, ())
    manifest = IndexFolder(report.folder).read_manifest()
    assert manifest.photos[1].content == manifest.photos[50].content == manifest.photos[51].content
    assert sum(s.photos for s in manifest.segments) == 6
    assert found(cfg, tmp_path / "photos" / "copy.jpg", quick) == [(1, 1.0)]


def test_processes_give_the_same_index(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 7)
    alone = build(cfg, index=tmp_path / "alone")
    together = build(cfg, index=tmp_path / "together", jobs=2)
    assert (together.extracted, together.descriptors) == (7, alone.descriptors)
    assert files(together.folder) == files(alone.folder)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_cancelled_build_keeps_what_was_finished(tmp_path, make_map, build, jobs):
    cfg = make_map(tmp_path, 24)
    whole = build(cfg, index=tmp_path / "whole")
    with pytest.raises(Cancelled):
        build(cfg, jobs=jobs, progress=CancelAfter(5))
    (spool,) = tmp_path.glob("derived/map/*/spool")
    kept = len([p for p in spool.iterdir() if p.suffix == ".features"])
    assert 5 <= kept < 24
    report = build(cfg)
    assert report.extracted == 24 - kept
    assert report.reused == kept
    assert files(report.folder) == files(whole.folder)


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


def test_a_full_disk_is_told_and_nothing_is_lost(tmp_path, make_map, build, monkeypatch):
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


def test_a_folder_that_cannot_be_made_is_told(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 2)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="--index FOLDER"):
        build(cfg, index=tmp_path / "file")


def test_a_second_builder_is_told(tmp_path, make_map, build):
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


DAMAGES = [
    damage_segment,
    delete("*.features"),
    delete("*.ivf"),
    delete("*.codebook"),
    delete("manifest.json"),
]
DAMAGES += [cut("*.features"), cut("*.ivf"), cut("*.codebook"), cut("manifest.json"), delete("*.*")]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__)
@pytest.mark.parametrize("features", ["sift", "orb"])
def test_a_damaged_index_is_mended(tmp_path, make_map, build, damage, features):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg, features=features).folder
    whole = files(folder)
    damage(folder)
    told = Notes()
    report = build(cfg, features=features, progress=told)
    assert report.failed == ()
    assert files(folder) == whole
    if (folder / "manifest.json").exists() and damage.__name__ not in ("delete manifest.json", "delete *.*"):
        assert any("anew" in note for note in told.notes)
    assert build(cfg, features=features).extracted == 0


def test_only_the_photos_of_a_damaged_segment_are_computed(tmp_path, make_map, save_photo, build, described):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg).folder
    (first,) = folder.glob("*.features")
    save_photo(tmp_path / "photos" / "new.jpg", 77)
    edit(cfg, lambda lines: lines.append("42;photos/new.jpg;50;50"))
    build(cfg)
    whole = files(folder)
    (second,) = {*folder.glob("*.features")} - {first}
    described.clear()
    second.write_bytes(b"")
    build(cfg)
    assert described == ["new.jpg"]
    assert files(folder) == whole


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


def test_many_small_additions_are_joined(tmp_path, make_map, build, described, quick):
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
    assert all(found(cfg, tmp_path / "photos" / f"{i}.jpg", quick)[0] == (i, 1.0) for i in (0, 11, 23))


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


def test_a_segment_with_much_that_is_gone_is_written_anew(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 10)
    folder = build(cfg).folder
    described.clear()
    edit(cfg, lambda lines: lines.__delitem__(slice(2, 6)))
    report = build(cfg)
    assert (report.removed, report.extracted, described) == (4, 0, [])
    (segment,) = folder.glob("*.features")
    assert len(read_segment(segment).content) == 6
    assert report.descriptors == len(read_segment(segment).xy)


def test_a_map_that_has_grown_much_is_divided_anew(tmp_path, make_map, build, described, quick):
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
from webapp.tasks import build_map
from webapp.tasks.open_map import OpenOptions
resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))
settings = Settings(extract=ExtractSettings(max_side_px=320, keypoints=20))
asked = OpenOptions(method="vote", jobs=1)
report = build_map.run(Path(sys.argv[1]), asked, settings=settings, progress=Progress())
print(report.index.extracted, len(report.index.failed))
"""


def test_few_files_are_open_at_a_time(tmp_path, make_map):
    cfg = make_map(tmp_path, 60)
    done = subprocess.run(
        [sys.executable, "-c", FEW_FILES, str(cfg)], capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "60 0\n", done.stderr
