"""Opening a map: choice of the index, when it is updated, and behaviour during a build."""

import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.opening import open_first_look
from tests.standin_models import brightest, glue
from webapp.core.retrieval.engines.ivf import InvertedFile
from webapp.core.retrieval.fields_of_view import guessed_fov_deg
from webapp.errors import IndexDamaged, MapError, StorageError, UsageError
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.tasks.localize import index_location, open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import OpenOptions


class Notes(Progress):
    """Records the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture
def opening(quick):
    """Open a map; return it and the notes of its progress."""

    def run(cfg: Path, method: str = "vote", **options) -> tuple[OpenMap, list[str]]:
        result = Notes()
        asked = OpenOptions(method=method, jobs=1, **options)
        return open_first_look(cfg, asked, settings=quick, progress=result), result.notes

    return run


@pytest.fixture
def read_only(monkeypatch, tmp_path):
    """Make a folder appear read-only, and put the user's cache into the test's folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(index_location, "user_cache_path", lambda name: tmp_path / "cache" / name)

    def lock(folder: Path) -> None:
        access = os.access
        monkeypatch.setattr(
            os, "access", lambda p, mode: not Path(p).is_relative_to(folder) and access(p, mode)
        )

    return lock


def listing(folder: Path) -> set[tuple[str, int]]:
    return {(str(p), p.stat().st_mtime_ns) for p in folder.rglob("*")}


def drop_line(cfg: Path, number: int) -> None:
    lines = cfg.read_text().splitlines(keepends=True)
    del lines[number]
    cfg.write_text("".join(lines))


def test_the_index_is_built_when_there_is_none_and_then_used(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 5)
    opened, notes = opening(cfg)
    assert notes[0] == "building the index"
    assert opened.built is not None
    assert opened.built.extracted == 5
    again, notes = opening(cfg)
    assert again.built is None
    assert notes == []
    assert again.map_hash == opened.map_hash
    assert again.indexed.ids.tolist() == [0, 1, 2, 3, 4]
    assert again.indexed.position.tolist() == [[100.0 * i + 100, 100.0] for i in range(5)]
    assert again.indexed.place_radius_px == 200.0


def test_a_changed_map_is_brought_up_to_date_and_said_so(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 5)
    before, _ = opening(cfg)
    drop_line(cfg, 2)
    opened, notes = opening(cfg)
    assert notes[0] == "the map has changed: updating its index"
    assert opened.built is not None
    assert (opened.built.extracted, opened.built.removed) == (0, 1)
    assert opened.map_hash != before.map_hash


def test_a_moved_photo_needs_no_build_but_is_another_map(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 4)
    before, _ = opening(cfg)
    cfg.write_text(cfg.read_text().replace(";200;100", ";210;100"))
    opened, notes = opening(cfg)
    assert (opened.built, notes) == (None, [])
    assert opened.indexed.position[1].tolist() == [210.0, 100.0]
    assert opened.map_hash != before.map_hash


def test_photos_that_cannot_be_used_are_not_tried_at_every_opening(tmp_path, make_map, opening, save_photo):
    cfg = make_map(tmp_path / "map", 5)
    photos = tmp_path / "map" / "photos"
    (photos / "0.jpg").unlink()
    (photos / "1.jpg").write_bytes(b"no photo")
    (photos / "2.jpg").rename(tmp_path / "outside.jpg")
    (photos / "2.jpg").symlink_to(tmp_path / "outside.jpg")
    opened, _ = opening(cfg)
    assert [i for i, _, _ in opened.built.failed] == [0, 1, 2]
    opened, notes = opening(cfg)
    assert (opened.built, notes) == (None, [])
    assert opened.indexed.features(0) is None
    assert len(opened.indexed.features(3)) > 50
    save_photo(photos / "0.jpg", 0)
    opened, _ = opening(cfg)
    assert [i for i, _, _ in opened.built.failed] == [1, 2]


def test_auto_takes_the_newest_index_that_fits(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 4)
    assert opening(cfg)[0].choice.name == "sift"
    assert opening(cfg, features="orb")[0].choice.name == "orb"
    newest, notes = opening(cfg)
    assert (newest.choice.name, newest.choice.matcher, notes) == ("orb", "hamming", [])
    fitting, notes = opening(cfg, matcher="l1")
    assert (fitting.choice.name, notes) == ("sift", [])
    assert opening(cfg, matcher="hamming")[0].choice.name == "orb"


def test_auto_takes_no_index_whose_model_is_not_here_any_more(tmp_path, make_map, quick):
    cfg = make_map(tmp_path / "map", 3)
    settings = replace(quick, models=tmp_path / "models")
    settings.models.mkdir()
    (settings.models / "disk.onnx").write_bytes(brightest("disk"))

    def chosen(method="vote", features="auto"):
        asked = OpenOptions(method=method, jobs=1, features=features)
        return open_first_look(cfg, asked, settings=settings, progress=Progress()).choice.name

    assert (chosen(), chosen(features="disk"), chosen()) == ("sift", "disk", "disk")
    (settings.models / "disk.onnx").unlink()
    assert chosen() == "sift"


def test_auto_takes_no_index_for_thorough_whose_pair_matcher_is_not_here(tmp_path, make_map, quick):
    cfg = make_map(tmp_path / "map", 3)
    settings = replace(quick, models=tmp_path / "models")
    settings.models.mkdir()
    (settings.models / "aliked.onnx").write_bytes(brightest("aliked"))
    asked = OpenOptions(method="vote", jobs=1, features="aliked")
    open_first_look(cfg, asked, settings=settings, progress=Progress())

    def chosen(method):
        bases = index_location.index_bases(cfg, None)
        ask = partial(index_location.newest_choice, bases, quick.extract, method=method, matcher=None)
        return ask(models=settings.models).name

    assert (chosen("verified"), chosen("thorough")) == ("aliked", "xfeat")
    (settings.models / "aliked_lightglue.onnx").write_bytes(glue())
    assert chosen("thorough") == "aliked"


def test_an_index_with_other_settings_is_not_taken(tmp_path, make_map, opening, quick):
    cfg = make_map(tmp_path, 4)
    opening(cfg, features="orb")
    folder = next(tmp_path.glob("derived/map/orb-*"))
    text = (folder / "manifest.json").read_text().replace('"keypoints": 120', '"keypoints": 99')
    (folder / "manifest.json").write_text(text)
    assert opening(cfg)[0].choice.name == "sift"


def test_a_matcher_that_no_index_fits_is_refused(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 2)
    with pytest.raises(UsageError, match="--features orb"):
        opening(cfg, matcher="hamming")


def test_building_takes_the_best_features_whatever_index_is_there(tmp_path, make_map, build):
    cfg = make_map(tmp_path, 3)
    assert build(cfg, features="orb").folder.name.startswith("orb-")
    assert build(cfg).folder.name.startswith("sift-")


@pytest.mark.parametrize(
    "options",
    [
        {"features": "sift", "matcher": "flann"},
        {"features": "sift", "matcher": "l1"},
        {"features": "sift", "matcher": "l2"},
        {"features": "sift-plain", "matcher": "l2"},
        {"features": "orb", "matcher": "flann"},
        {"features": "orb", "matcher": "hamming"},
        {"features": "orb", "matcher": "hamming2"},
        {"detector": "orb", "extractor": "sift"},
        {"detector": "sift", "extractor": "orb"},
    ],
)
def test_every_matcher_finds_a_photo_of_the_map_itself(tmp_path, make_map, opening, quick, options):
    cfg = make_map(tmp_path, 4)
    opened, _ = opening(cfg, **options)
    answer = LocalizationPipeline(opened.method, (Look(opened),)).localize(
        tmp_path / "photos" / "2.jpg", top=3
    )
    assert answer.hypotheses[0].experiences == (2,)
    assert answer.hypotheses[0].probability > 0.9
    if options.get("matcher") != "flann":
        assert answer.statistics.distance_max == 0.0


@pytest.mark.parametrize("features", ["sift", "orb"])
def test_verified_finds_a_photo_of_the_map_itself_with_every_kind_of_index(
    tmp_path, make_map, quick, features
):
    cfg = make_map(tmp_path, 4)
    localizer = open_pipeline(
        cfg, OpenOptions(features=features, jobs=1), settings=quick, progress=Progress()
    )
    assert isinstance(localizer.opened.indexed.search, InvertedFile)
    answer = localizer.localize(tmp_path / "photos" / "2.jpg", top=3)
    assert answer.hypotheses[0].experiences[0] == 2
    total = sum(h.probability for h in answer.hypotheses) + answer.other_probability
    assert total + answer.off_map_probability == pytest.approx(1.0)


def test_a_damaged_index_is_reported_with_what_mends_it(tmp_path, make_map, opening, build):
    cfg = make_map(tmp_path, 4)
    opened, _ = opening(cfg)
    for path in opened.folder.folder.glob("*.features"):
        path.write_bytes(path.read_bytes()[:-64])
    with pytest.raises(IndexDamaged, match="expmap build"):
        opening(cfg)
    build(cfg)
    assert opening(cfg)[0].map_hash == opened.map_hash


def test_a_map_without_photos_or_texture_is_a_bad_map(tmp_path, make_map, opening):
    with pytest.raises(MapError, match="no photos"):
        opening(make_map(tmp_path / "empty", 0))
    cfg = make_map(tmp_path / "gone", 2)
    for photo in (tmp_path / "gone" / "photos").iterdir():
        photo.unlink()
    with pytest.raises(MapError, match="can be used; 2 photos: file not found, such as photos/0"):
        opening(cfg)
    blank = make_map(tmp_path / "blank", 2)
    for photo in (tmp_path / "blank" / "photos").iterdir():
        Image.new("L", (64, 48)).save(photo, "JPEG")
    with pytest.raises(MapError, match="no photo of the map has features"):
        opening(blank)


def test_a_reader_during_a_build_takes_the_new_manifest(tmp_path, make_map, opening, build, monkeypatch):
    cfg = make_map(tmp_path, 9)
    opening(cfg)
    load, calls = open_index._load, []

    def late(folder, manifest, **given):
        """Another process finishes a build between reading the manifest and the files it names."""
        calls.append(manifest)
        if len(calls) == 1:
            for _ in range(5):
                drop_line(cfg, 1)
            build(cfg)
        return load(folder, manifest, **given)

    monkeypatch.setattr(open_index, "_load", late)
    opened, _ = opening(cfg)
    assert len(calls) == 2
    assert calls[0].segments != calls[1].segments
    # The map was read earlier: photos removed since are included, without features.
    assert len(opened.indexed.ids) == 9
    assert [opened.indexed.features(i) is None for i in range(9)] == [True] * 5 + [False] * 4
    assert opened.map_hash


def test_an_open_map_outlives_its_files(tmp_path, make_map, opening, quick):
    cfg = make_map(tmp_path, 4)
    opened, _ = opening(cfg)
    shutil.rmtree(tmp_path / "derived")
    answer = LocalizationPipeline(opened.method, (Look(opened),)).localize(
        tmp_path / "photos" / "1.jpg", top=1
    )
    assert answer.hypotheses[0].experiences == (1,)


def test_a_map_that_another_process_builds_is_reported(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 2)
    opened, _ = opening(cfg)
    drop_line(cfg, 1)
    with writer_lock(opened.folder.folder), pytest.raises(StorageError, match="another process"):
        opening(cfg)


def test_a_map_that_cannot_be_written_has_its_index_in_the_cache(tmp_path, make_map, opening, read_only):
    cfg = make_map(tmp_path / "map", 4)
    read_only(tmp_path / "map")
    before = listing(tmp_path / "map")
    opened, _ = opening(cfg)
    assert opened.folder.folder.is_relative_to(tmp_path / "cache")
    assert opening(cfg)[1] == []
    assert listing(tmp_path / "map") == before


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_an_index_next_to_a_map_that_cannot_be_written_is_used(
    tmp_path, make_map, quick, read_only, method, build
):
    cfg = make_map(tmp_path / "map", 5)
    build(cfg)
    read_only(tmp_path / "map")
    before, result = listing(tmp_path / "map"), Notes()
    for _ in range(2):
        result.notes.clear()
        asked = OpenOptions(method=method, jobs=1)
        localizer = open_pipeline(cfg, asked, settings=quick, progress=result)
        assert localizer.opened.built is None
        assert localizer.opened.folder.folder.is_relative_to(tmp_path / "map")
    assert result.notes == []  # the calibration is also kept, in the cache
    assert listing(tmp_path / "map") == before


def test_an_old_index_next_to_a_map_that_cannot_be_written_is_not_used(
    tmp_path, make_map, opening, build, read_only
):
    cfg = make_map(tmp_path / "map", 5)
    build(cfg)
    drop_line(cfg, 1)
    read_only(tmp_path / "map")
    opened, _ = opening(cfg)
    assert opened.folder.folder.is_relative_to(tmp_path / "cache")
    assert opened.indexed.ids.tolist() == [1, 2, 3, 4]


def test_a_folder_for_indexes_serves_several_maps(tmp_path, make_map, opening):
    a, b = make_map(tmp_path / "a", 3), make_map(tmp_path / "b", 2)
    shelf = tmp_path / "shelf"
    opening(a, index=shelf), opening(b, index=shelf)
    assert opening(a, index=shelf)[1] == opening(b, index=shelf)[1] == []
    assert not (tmp_path / "a" / "derived").exists()


def test_fields_of_view_come_from_the_option_or_a_guess(tmp_path, make_map, opening):
    cfg = make_map(tmp_path, 3)
    guessed = opening(cfg)[0].indexed.fov_deg
    assert np.allclose(guessed, guessed_fov_deg(320, 240))
    assert guessed_fov_deg(320, 240) == pytest.approx(65.0)
    assert guessed_fov_deg(240, 320) < 65.0
    given = opening(cfg, map_fov_deg=50.0)[0].indexed.fov_deg
    assert given.tolist() == [50.0] * 3
