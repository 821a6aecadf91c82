"""Maps searched by signatures: built, changed, damaged, stopped; and when they are chosen."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.opening import open_first_look
from webapp.core.features.table import choose
from webapp.errors import Cancelled, UsageError
from webapp.files.localize.index_store import IndexFolder
from webapp.progress import Progress
from webapp.settings import RetrievalSettings, Settings
from webapp.tasks.localize import build_map, segments
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import OpenOptions


@pytest.fixture
def opening(quick):
    """Open a map, building what is missing."""

    def run(cfg: Path, *, memory_mb: float = 500.0, **options: object) -> OpenMap:
        asked = OpenOptions(features="sift", jobs=1, **options)
        settings = replace(quick, retrieval=RetrievalSettings(memory_mb))
        return open_first_look(cfg, asked, settings=settings, progress=Progress())

    return run


@pytest.fixture
def first_named(quick):
    """Return the id of the best photo."""

    def run(opened: OpenMap, photo: Path, settings: Settings = quick) -> int:
        answer = LocalizationPipeline(opened.method, (Look(opened),), fov_deg=60.0).localize(photo, top=1)
        return answer.hypotheses[0].experiences[0]

    return run


def test_photos_are_found_after_adding_and_removing(
    tmp_path, make_map, opening, described, edit, first_named, save_photo
):
    cfg = make_map(tmp_path, 8)
    photos = tmp_path / "photos"
    opened = opening(cfg, matcher="vlad")
    assert opened.manifest.engine == opened.choice.matcher == "vlad"
    assert [first_named(opened, photos / f"{i}.jpg") for i in range(8)] == list(range(8))
    assert not list(opened.folder.folder.glob("*.ivf"))
    described.clear()
    edit(cfg, lambda lines: lines.pop(3))
    save_photo(photos / "new.jpg", 77)
    edit(cfg, lambda lines: lines.append("70;photos/new.jpg;9;9"))
    again = opening(cfg, matcher="vlad")
    assert described == ["new.jpg"]
    assert again.manifest.codebook == opened.manifest.codebook
    assert first_named(again, photos / "new.jpg") == 70
    assert first_named(again, photos / "5.jpg") == 5
    assert (again.indexed.photo_of_entry == -1).sum() == 1
    assert first_named(again, photos / "2.jpg") != 2


def test_the_way_of_searching_can_change_and_nothing_is_described_again(
    tmp_path, make_map, opening, described, first_named
):
    cfg = make_map(tmp_path, 6)
    assert opening(cfg).manifest.engine == "ivf"
    described.clear()
    small = opening(cfg, memory_mb=0.001)  # too little memory for the descriptors
    assert small.manifest.engine == small.choice.matcher == "vlad"
    assert first_named(small, tmp_path / "photos" / "4.jpg") == 4
    assert {p.suffix for p in small.folder.folder.iterdir() if "-" in p.name} == {".vlad"}
    # without building, the existing index is used
    assert opening(cfg, build=False).choice.matcher == "vlad"
    back = opening(cfg)
    assert back.manifest.engine == back.choice.matcher == "ivf"
    assert described == []
    assert opening(cfg, method="vote").built is None  # uses the descriptors themselves


@pytest.mark.parametrize("damaged", ["*.vlad", "*.codebook"])
def test_what_is_damaged_is_made_again(tmp_path, make_map, opening, damaged, quick):
    cfg = make_map(tmp_path, 5)
    folder = opening(cfg, matcher="vlad").folder.folder
    before = {p.name: p.read_bytes() for p in folder.glob("*.*") if p.suffix != ".json"}
    (path,) = folder.glob(damaged)
    path.write_bytes(path.read_bytes()[:-70])
    manifest = IndexFolder(folder).read_manifest()
    making = segments.coding_of(IndexFolder(folder), "vlad", kind="float")
    assert not making.holds(manifest.segments[0], codebook=manifest.codebook)
    asked = OpenOptions(features="sift", matcher="vlad", jobs=1)
    build_map.build_map(cfg, asked, settings=quick, progress=Progress())
    after = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    assert before.items() <= after.items()


def test_a_build_that_was_stopped_before_its_signatures_continues(
    tmp_path, make_map, opening, described, first_named, monkeypatch
):
    cfg = make_map(tmp_path, 5)

    def stop(*_):
        raise Cancelled("stopped")

    with monkeypatch.context() as patch:
        patch.setattr(segments, "write_signatures", stop)
        with pytest.raises(Cancelled):
            opening(cfg, matcher="vlad")
    described.clear()
    opened = opening(cfg, matcher="vlad")
    assert described == []
    assert first_named(opened, tmp_path / "photos" / "3.jpg") == 3


SLOWLY = """
import sys, time
from pathlib import Path
from webapp.core.retrieval.engines import vlad
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from tests.opening import open_first_look
from webapp.tasks.localize import segments
from webapp.tasks.localize.plan import OpenOptions
quick = vlad.signature
def slow(*given):
    time.sleep(0.1)
    return quick(*given)
vlad.signature = slow
segments.PHOTOS_PER_SEGMENT = 3
asked = OpenOptions(features="sift", matcher="vlad", jobs=1)
settings = Settings(extract=ExtractSettings(max_side_px=320, keypoints=120))
open_first_look(Path(sys.argv[1]), asked, settings=settings, progress=Progress())
"""


def files_of(folder: Path) -> dict[str, bytes]:
    """Return the files of an index except the manifest, which contains the duration of the build."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and p.suffix != ".json"}


def test_a_build_that_was_killed_among_its_signatures_continues(
    tmp_path, make_map, opening, described, first_named, monkeypatch
):
    monkeypatch.setattr(segments, "PHOTOS_PER_SEGMENT", 3)
    cfg = make_map(tmp_path, 9)
    undisturbed = opening(cfg, matcher="vlad", index=tmp_path / "undisturbed").folder.folder
    assert len(list(undisturbed.glob("*.vlad"))) == 3
    root = Path(__file__).resolve().parents[3]
    for seen in ("*.codebook", "*.vlad"):  # before the first signatures, and among them
        with subprocess.Popen([sys.executable, "-c", SLOWLY, str(cfg)], cwd=root) as building:
            until = time.monotonic() + 120.0
            while not any(tmp_path.glob(f"derived/*/*/{seen}")):
                assert building.poll() is None, "it ended before it was killed"
                assert time.monotonic() < until, "it did not happen"
                time.sleep(0.01)
            building.kill()
        assert len(list(tmp_path.glob("derived/*/*/*.vlad"))) < 3
        assert not list(tmp_path.glob("derived/*/*/manifest.json"))
    described.clear()
    opened = opening(cfg, matcher="vlad")
    assert described == []
    assert files_of(opened.folder.folder) == files_of(undisturbed)
    assert [first_named(opened, tmp_path / "photos" / f"{i}.jpg") for i in range(9)] == list(range(9))


def test_photos_described_by_a_network_are_found(tmp_path, make_map, quick, shared_models, first_named):
    asked = OpenOptions(features="xfeat", matcher="vlad", jobs=1)
    settings = replace(quick, models=shared_models)
    opened = open_first_look(make_map(tmp_path, 6), asked, settings=settings, progress=Progress())
    assert opened.manifest.engine == opened.choice.matcher == "vlad"
    assert [first_named(opened, tmp_path / "photos" / f"{i}.jpg", settings) for i in range(6)] == list(
        range(6)
    )


def test_only_descriptors_of_numbers_have_signatures():
    assert choose("verified", features="sift", matcher="vlad").engine == "vlad"
    with pytest.raises(UsageError, match="binary"):
        choose("verified", features="orb", matcher="vlad")
