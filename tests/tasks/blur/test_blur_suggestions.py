"""Faces and plates are searched in all photos of a map, once per photo, and blurred on request."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.killing import Step, run_until
from tests.standin_models import install_blur_networks
from webapp.core.boxes import BlurBox
from webapp.core.detections import Detection, LpdYuNet
from webapp.errors import Cancelled, MissingPart
from webapp.files.localize.models import blur_networks
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.blur import find
from webapp.tasks.blur.find import DetectionCache, accept_in_folder, photos_of, search_photos

LIMITS = Settings().photo
ROOT = Path(__file__).resolve().parents[3]


def search(cfg, networks, progress=None, **options):
    progress = progress or Progress()
    return search_photos(cfg, photos_of(cfg), networks=networks, limits=LIMITS, progress=progress, **options)


def test_what_is_found_is_blurred_in_the_files_and_not_found_again(tmp_path, spotted, networks):
    cfg = spotted(tmp_path / "park", 3)
    report = search(cfg, networks)
    assert [one.id for one in report.suggested] == [1, 2]
    assert (report.searched, report.failed) == (3, ())
    boxes = report.suggested[0].boxes
    assert {one.kind for one in boxes} == {"face", "plate"}
    assert all(one.box.x < 200 / 320 < one.box.x + one.box.width for one in boxes)
    assert all(not e.blurred for e in read_map(cfg).experiences)
    assert accept_in_folder(cfg, report.suggested) == [1, 2]
    blurred = [e.blurred for e in read_map(cfg).experiences]
    assert [bool(boxes) for boxes in blurred] == [False, True, True]
    assert search(cfg, networks).suggested == ()
    assert accept_in_folder(cfg, report.suggested) == []


def test_less_sure_ones_can_be_left_out(tmp_path, spotted, networks):
    cfg = spotted(tmp_path / "park", 2)
    assert search(cfg, networks).suggested
    assert search(cfg, networks, least_score=0.95).suggested == ()


def test_a_damaged_photo_is_named_and_the_others_are_searched(tmp_path, spotted, networks):
    cfg = spotted(tmp_path / "park", 3)
    (cfg.parent / "photos" / "1.jpg").write_bytes(b"no photo")
    report = search(cfg, networks)
    assert [one.id for one in report.suggested] == [2]
    assert [(one.id, one.photo) for one in report.failed] == [(1, "photos/1.jpg")]
    assert report.searched == 2


def test_a_link_out_of_the_map_is_named_and_the_others_are_searched(tmp_path, spotted, networks):
    cfg = spotted(tmp_path / "park", 3)
    photo = cfg.parent / "photos" / "1.jpg"
    photo.rename(tmp_path / "elsewhere.jpg")
    photo.symlink_to(tmp_path / "elsewhere.jpg")
    report = search(cfg, networks)
    assert [one.id for one in report.suggested] == [2]
    assert [one.id for one in report.failed] == [1]


def test_more_than_a_photo_may_have_is_named(tmp_path, spotted, networks, monkeypatch):
    cfg = spotted(tmp_path / "park", 2)
    monkeypatch.setattr(find, "MOST_BOXES", 1)
    report = search(cfg, networks)
    assert [(one.id, len(one.boxes), one.left) for one in report.suggested] == [(1, 1, 3)]
    (failed,) = report.failed
    assert failed.reason.startswith("a photo may have 1 boxes, and 3 more")
    assert report.searched == 2
    accept_in_folder(cfg, report.suggested)
    again = search(cfg, networks)
    assert again.suggested == ()
    assert [one.id for one in again.failed] == [1]


def test_a_large_photo_is_searched_at_the_size_that_matters(tmp_path, spotted, networks, monkeypatch):
    cfg = spotted(tmp_path / "park", 2)
    monkeypatch.setattr(find, "_SIDE", 160)
    sizes = []
    real = LpdYuNet.detect
    monkeypatch.setattr(LpdYuNet, "detect", lambda self, p, **o: sizes.append(p.shape) or real(self, p, **o))
    search(cfg, networks)
    assert sizes == [(120, 160, 3)] * 2


class StopAfter(Progress):
    def __init__(self, steps):
        self.left = steps

    def advance(self, steps=1):
        self.left -= steps

    def cancelled(self):
        return self.left <= 0


def test_a_search_that_was_stopped_goes_on_where_it_was(tmp_path, spotted, networks, monkeypatch):
    cfg = spotted(tmp_path / "park", 4)
    with pytest.raises(Cancelled):
        search(cfg, networks, StopAfter(3))
    read = []
    real = find.read_in_turn
    monkeypatch.setattr(find, "read_in_turn", lambda file, **o: read.append(1) or real(file, **o))
    assert len(search(cfg, networks).suggested) == 3
    assert len(read) == 1


def test_a_killed_search_loses_one_photo_at_most(tmp_path, spotted, networks, models):
    cfg = spotted(tmp_path / "park", 4)
    program = f"""
import operator, os, signal
from pathlib import Path
from tests.standin_models import install_blur_networks
from webapp.core.detections import LpdYuNet
from webapp.files.localize.models import blur_networks
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.blur.find import photos_of, search_photos
folder = install_blur_networks(Path({str(models)!r}), operator.setitem)
real, seen = LpdYuNet.detect, []
def detect(self, pixels, **options):
    seen.append(1)
    if len(seen) == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(self, pixels, **options)
LpdYuNet.detect = detect
cfg, networks = Path({str(cfg)!r}), blur_networks(folder)
search_photos(cfg, photos_of(cfg), networks=networks, limits=Settings().photo, progress=Progress())
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, check=False
    )
    assert ended.returncode == -9
    kept = DetectionCache(cfg.parent, networks.key)
    before = kept.read()
    assert len(before) == 2
    assert len(search(cfg, networks).suggested) == 3
    assert len(kept.read()) == 4


def test_a_map_in_a_folder_stays_whole_when_accepting_is_killed(tmp_path, spotted, networks):
    cfg, undisturbed = spotted(tmp_path / "park", 3), spotted(tmp_path / "undisturbed", 3)
    suggested, before = search(cfg, networks).suggested, read_map(cfg)
    accept_in_folder(undisturbed, suggested)
    after = read_map(undisturbed)
    for step, found in (
        (Step("webapp.files.maps.folder:write_bytes"), before),
        (Step("webapp.files.maps.folder:write_bytes", calls=1), after),
    ):
        assert run_until(step, accept_in_folder, cfg, suggested), step
        assert read_map(cfg) == found, step
    assert accept_in_folder(cfg, suggested) == [], "nothing is left to be blurred"
    assert read_map(cfg) == after


def test_a_line_that_was_cut_off_is_searched_again_and_harms_no_other(tmp_path):
    kept = DetectionCache(tmp_path, "key")
    face = Detection("face", BlurBox(0.1, 0.2, 0.3, 0.4), 0.9)
    kept.add("a", [face])
    (file,) = (tmp_path / "derived" / "blur").glob("*.jsonl")
    with file.open("ab") as opened:
        opened.write(b'\n{"photo": "b", "fou')
    kept.add("c", [])
    assert kept.read() == {"a": [face], "c": []}


def test_what_one_network_has_found_is_not_taken_for_both(tmp_path, spotted, monkeypatch):
    cfg = spotted(tmp_path / "park", 2)
    folder = install_blur_networks(tmp_path / "one", monkeypatch.setitem, models=["faces"])
    faces = blur_networks(folder)
    assert faces.missing == ("plates",)
    assert {d.kind for one in search(cfg, faces).suggested for d in one.boxes} == {"face"}
    install_blur_networks(folder, monkeypatch.setitem, models=["plates"])
    both = search(cfg, blur_networks(folder))
    assert {d.kind for one in both.suggested for d in one.boxes} == {"face", "plate"}


def test_without_networks_one_sentence_says_what_to_install(tmp_path):
    with pytest.raises(MissingPart) as refused:
        blur_networks(tmp_path)
    assert str(refused.value) == (
        "models: no network that finds faces or number plates is installed "
        "(the administrator of the server can install them: expmap models fetch faces plates)"
    )
