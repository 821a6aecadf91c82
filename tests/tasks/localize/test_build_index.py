"""Building: only changed photos are computed, and nothing is lost or wrong."""

import os
import shutil
from pathlib import Path

import cv2
import pytest

from tests.opening import open_first_look as open_map
from webapp.files.localize.index_store import IndexFolder
from webapp.progress import Progress
from webapp.tasks.localize import extract_photo
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import OpenOptions


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    return {p.name: (p.stat().st_mtime_ns, p.stat().st_ino) for p in folder.iterdir() if p.is_file()}


def test_first_everything_then_nothing(tmp_path, make_map, build, described):
    cfg = make_map(tmp_path, 6)
    first = build(cfg)
    assert (first.photos, first.extracted, first.reused, first.removed, first.failed) == (6, 6, 0, 0, ())
    assert described == [f"{i}.jpg" for i in range(6)]
    assert first.descriptors > 6 * 50
    assert first.folder == tmp_path / "derived" / "map" / first.folder.name
    assert first.bytes == sum(p.stat().st_size for p in first.folder.rglob("*") if p.is_file())
    assert not list((first.folder / "spool").iterdir())
    before = stamps(first.folder)
    again = build(cfg)
    assert (again.photos, again.extracted, again.reused, again.removed) == (6, 0, 6, 0)
    assert again.descriptors == first.descriptors
    assert stamps(first.folder) == before
    assert len(described) == 6


def test_a_photo_is_read_once_however_many_lines_name_it(tmp_path, make_map, build, monkeypatch, edit):
    cfg = make_map(tmp_path, 2)
    again = [f"{n};{'./' * (n % 2)}photos/0.jpg;{n};9" for n in range(10, 40)]
    edit(cfg, lambda lines: lines.extend(again))
    read, names = extract_photo.read_file, []
    monkeypatch.setattr(extract_photo, "read_file", lambda p, **o: (names.append(p.name), read(p, **o))[1])
    report = build(cfg)
    assert names == ["0.jpg", "1.jpg"]
    assert (report.photos, report.extracted, report.reused, report.failed) == (32, 2, 30, ())


def test_an_added_photo_costs_that_photo_only(
    tmp_path, make_map, save_photo, build, described, lasting, edit, found
):
    cfg = make_map(tmp_path, 5)
    folder = build(cfg).folder
    before = lasting(folder)
    described.clear()
    save_photo(tmp_path / "photos" / "new.jpg", 77)
    edit(cfg, lambda lines: lines.insert(3, "42;photos/new.jpg;50;50"))
    report = build(cfg)
    assert described == ["new.jpg"]
    assert (report.extracted, report.reused) == (1, 5)
    assert before.items() <= lasting(folder).items()
    assert found(cfg, tmp_path / "photos" / "new.jpg")[0][0] == 42
    assert all(found(cfg, tmp_path / "photos" / f"{i}.jpg")[0][0] == i for i in range(5))


def test_a_moved_photo_costs_nothing(tmp_path, make_map, build, described, quick, edit):
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
    best = (
        LocalizationPipeline(opened.method, (Look(opened),))
        .localize(tmp_path / "photos" / "1.jpg", top=1)
        .hypotheses[0]
    )
    assert (best.position.x, best.position.y) == (7.0, 9.0)


@pytest.mark.parametrize("features", ["sift", "orb"])
def test_a_removed_photo_costs_nothing_and_never_answers(
    tmp_path, make_map, build, described, features, lasting, edit, found
):
    cfg = make_map(tmp_path, 6)
    first = build(cfg, features=features)
    before = lasting(first.folder)
    described.clear()
    edit(cfg, lambda lines: lines.pop(3))
    report = build(cfg, features=features)
    assert (report.photos, report.extracted, report.reused, report.removed) == (5, 0, 5, 1)
    assert report.descriptors < first.descriptors
    assert described == []
    assert lasting(first.folder) == before
    answers = found(cfg, tmp_path / "photos" / "2.jpg", features=features)
    assert answers
    assert 2 not in [i for i, _ in answers]
    assert sum(p for _, p in answers) == pytest.approx(1.0)


def test_a_removed_photo_that_comes_back_is_found_again(tmp_path, make_map, build, edit, found):
    cfg = make_map(tmp_path, 5)
    whole = cfg.read_text()
    build(cfg)
    edit(cfg, lambda lines: lines.pop(3))
    build(cfg)
    cfg.write_text(whole)
    report = build(cfg)
    assert (report.photos, report.reused + report.extracted) == (5, 5)
    assert found(cfg, tmp_path / "photos" / "2.jpg")[0] == (2, 1.0)


def test_a_changed_photo_is_computed_again(tmp_path, make_map, save_photo, build, described, found):
    cfg = make_map(tmp_path, 4)
    old = tmp_path / "old.jpg"
    shutil.copy(tmp_path / "photos" / "2.jpg", old)
    build(cfg)
    described.clear()
    save_photo(tmp_path / "photos" / "2.jpg", 99)
    report = build(cfg)
    assert described == ["2.jpg"]
    assert (report.extracted, report.reused, report.removed) == (1, 3, 0)
    assert found(cfg, tmp_path / "photos" / "2.jpg")[0] == (2, 1.0)
    assert found(cfg, old)[0][1] < 1.0


def test_renamed_touched_and_exchanged_photos_are_read_but_not_computed(
    tmp_path, make_map, build, described, lasting, edit, found
):
    cfg = make_map(tmp_path, 4)
    folder = build(cfg).folder
    before = lasting(folder)
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
    assert lasting(folder) == before
    assert found(cfg, photos / "2.jpg")[0] == (2, 1.0)
    assert found(cfg, photos / "zero.jpg")[0] == (0, 1.0)


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


def test_unusable_photos_are_reported_and_the_others_built(tmp_path, make_map, build, described, found):
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
    assert "file not found" in reason[0]
    assert "empty" in reason[1]
    assert "not an image" in reason[2]
    assert "a folder and not a photo" in reason[4]
    assert "points outside the map's folder" in reason[5]
    assert str(tmp_path) not in " ".join(reason.values())
    assert (report.photos, report.extracted, report.reused) == (9, 3, 0)
    assert found(cfg, photos / "8.jpg")[0] == (8, 1.0)
    described.clear()
    again = build(cfg)
    assert again.failed == report.failed
    assert described == ["2.jpg", "3.jpg"]  # a build retries failed photos


def test_a_repaired_photo_is_taken_up(tmp_path, make_map, save_photo, build):
    cfg = make_map(tmp_path, 3)
    (tmp_path / "photos" / "1.jpg").unlink()
    assert len(build(cfg).failed) == 1
    save_photo(tmp_path / "photos" / "1.jpg", 1)
    report = build(cfg)
    assert (report.failed, report.extracted, report.reused) == ((), 1, 2)


def test_a_photo_that_breaks_later_no_longer_answers(tmp_path, make_map, build, found):
    cfg = make_map(tmp_path, 4)
    copy = tmp_path / "query.jpg"
    shutil.copy(tmp_path / "photos" / "1.jpg", copy)
    build(cfg)
    (tmp_path / "photos" / "1.jpg").unlink()
    report = build(cfg)
    assert [i for i, _, _ in report.failed] == [1]
    assert 1 not in [i for i, _ in found(cfg, copy)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_one_photo_under_two_ids_is_held_once(tmp_path, make_map, build, jobs, edit, found):
    cfg = make_map(tmp_path, 6)
    shutil.copy(tmp_path / "photos" / "1.jpg", tmp_path / "photos" / "copy.jpg")
    edit(cfg, lambda lines: lines.extend(["50;photos/1.jpg;5;5", "51;photos/copy.jpg;6;6"]))
    report = build(cfg, jobs=jobs)
    assert (report.photos, report.failed) == (8, ())
    manifest = IndexFolder(report.folder).read_manifest()
    assert manifest.photos[1].content == manifest.photos[50].content == manifest.photos[51].content
    assert sum(s.photos for s in manifest.segments) == 6
    assert found(cfg, tmp_path / "photos" / "copy.jpg") == [(1, 1.0)]


def test_processes_give_the_same_index(tmp_path, make_map, build, lasting):
    cfg = make_map(tmp_path, 7)
    alone = build(cfg, index=tmp_path / "alone")
    together = build(cfg, index=tmp_path / "together", jobs=2)
    assert (together.extracted, together.descriptors) == (7, alone.descriptors)
    assert lasting(together.folder) == lasting(alone.folder)
