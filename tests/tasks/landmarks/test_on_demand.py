"""Landmarks around the place of a query, on a map without landmarks."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.tasks.landmarks.conftest import KEYPOINTS
from tests.tasks.landmarks.rendered import PIXELS_PER_METRE, SIDE, render
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud
from webapp.files.lock import writer_lock
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import LandmarkSettings, Settings
from webapp.tasks.landmarks import on_demand
from webapp.tasks.landmarks.accept import accept_in_folder
from webapp.tasks.landmarks.mapping import MATCHES_FILE
from webapp.tasks.landmarks.on_demand import photos_around
from webapp.tasks.landmarks.place_rest import suggest_rest
from webapp.tasks.landmarks.reconstruct import SURROUNDINGS, reconstruct
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

pytestmark = pytest.mark.slow

LANDMARKS = OpenOptions(method="landmarks")


def settings(*, around_s=3600.0):
    """Return settings with a time limit that is long enough for slow machines."""
    return Settings(landmarks=LandmarkSettings(around_s=around_s))


def opened(cfg, **chosen):
    return open_pipeline(cfg, LANDMARKS, settings=settings(**chosen), progress=Progress())


@pytest.fixture(scope="module")
def all_placed(joined_court, tmp_path_factory):
    """The court with all its photos placed, an index and no landmarks; read-only."""
    folder = tmp_path_factory.mktemp("around") / "court"
    shutil.copytree(joined_court.cfg.parent, folder)
    cfg = folder / "map.cfg"
    accept_in_folder(cfg, suggest_rest(cfg, settings=Settings(), progress=Progress()).suggested)
    for file in landmarks_folder(cfg).glob("*.arrays"):
        file.unlink()
    opened(cfg)
    return cfg


@pytest.fixture
def bare(all_placed, tmp_path):
    """A copy of it that a test may change."""
    shutil.copytree(all_placed.parent, tmp_path / "court")
    return tmp_path / "court" / "map.cfg"


@pytest.fixture
def query(tmp_path):
    """A photo of the court, and its position, map pixels."""
    x, y = SIDE / 2 + 4.2 * np.cos(0.9), SIDE / 2 + 3.2 * np.sin(0.9)
    path = tmp_path / "query.png"
    cv2.imwrite(str(path), render(x, y, 0.9 - np.pi / 2 + 0.4))
    return path, np.array([x, y]) * PIXELS_PER_METRE


def parts(cfg):
    return sorted((landmarks_folder(cfg) / SURROUNDINGS).glob("*/photos.json"))


def without_landmarks(localizer):
    """Return the localizer without landmarks on demand."""
    (look,) = localizer.looks
    return replace(localizer, looks=(replace(look, around=None),))


def test_the_surroundings_are_reconstructed_once(bare, query, monkeypatch):
    path, at = query
    localizer = opened(bare)
    usual = without_landmarks(localizer).localize(path, top=3)
    answer = localizer.localize(path, top=3)
    first = answer.hypotheses[0]
    assert localizer.method == "landmarks"
    assert answer.note == ""
    assert first.camera.landmarks > 100
    assert abs(first.camera.pitch_deg) < 0.2
    assert np.hypot(*(first.position - at)) < 0.1 * PIXELS_PER_METRE
    assert first.probability == usual.hypotheses[0].probability
    assert answer.hypotheses[1:] == usual.hypotheses[1:]
    assert len(parts(bare)) == 1

    def built_again(*_args, **_options):
        raise AssertionError("the surroundings are there")

    monkeypatch.setattr(on_demand, "reconstruct_part", built_again)
    again = opened(bare).localize(path, top=3)
    np.testing.assert_allclose(again.hypotheses[0].position, first.position)


def test_too_little_time_leaves_the_usual_answer_and_says_so(bare, query):
    path, _ = query
    localizer = opened(bare, around_s=1e-6)
    answer = localizer.localize(path, top=3)
    assert answer.hypotheses == without_landmarks(localizer).localize(path, top=3).hypotheses
    assert "take longer than 1e-06 s" in answer.note
    assert parts(bare) == []
    assert opened(bare).localize(path, top=3).note == ""


KILLED = """
import os, signal, sys
from dataclasses import replace
from pathlib import Path
from webapp.files.landmarks.match_database import MatchDatabase
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import LandmarkSettings, Settings
from webapp.tasks.landmarks import reconstruct
from webapp.tasks.landmarks.on_demand import reconstruct_part

reconstruct._EXTRACT = replace(reconstruct._EXTRACT, keypoints=int(sys.argv[4]))
cfg, pairs, written = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
keep, replace_file = MatchDatabase.keep, Path.replace

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def keep_or_die(self, *pair, **geometry):
    global pairs
    pairs -= 1
    return die() if pairs < 0 else keep(self, *pair, **geometry)

def replace_or_die(self, target):
    return die() if Path(target).name == written else replace_file(self, target)

MatchDatabase.keep, Path.replace = keep_or_die, replace_or_die
the_map, settings = read_map(cfg), Settings(landmarks=LandmarkSettings(around_s=3600.0))
reconstruct_part(cfg, the_map, photos=the_map.experiences, settings=settings, progress=Progress())
"""


def test_killed_work_goes_on_where_it_stopped_and_leaves_nothing_behind(bare, counted):
    the_map, folder = read_map(bare), landmarks_folder(bare)
    before = {path: path.read_bytes() for path in bare.parent.glob("*") if path.is_file()}
    for file in folder.glob(f"{MATCHES_FILE}*"):
        file.unlink()
    for pairs, written in ((5, "nothing"), (1000, CLOUD_FILE), (0, "photos.json")):
        command = [sys.executable, "-c", KILLED, bare, str(pairs), written, str(KEYPOINTS)]
        ended = subprocess.run(command, check=False)
        assert ended.returncode == -signal.SIGKILL, written
        assert on_demand.part_around(bare, the_map.experiences) is None
        if written == "nothing":
            with closing(sqlite3.connect(folder / MATCHES_FILE)) as database:
                assert database.execute("SELECT count(*) FROM two_view_geometries").fetchone() == (5,)
    progress = counted()
    part = on_demand.reconstruct_part(
        bare, the_map, photos=the_map.experiences, settings=settings(), progress=progress
    )
    assert progress.sizes == [len(the_map.experiences), 0], "no photo and no pair is done twice"
    assert on_demand.part_around(bare, the_map.experiences) == part
    assert len(read_cloud(part / CLOUD_FILE).cloud.point) > 100
    assert {path: path.read_bytes() for path in bare.parent.glob("*") if path.is_file()} == before
    assert [path for path in folder.rglob("*") if path.name.endswith(".tmp")] == []


def test_while_another_process_reconstructs_nothing_is_built_twice(bare, query):
    path, _ = query
    with writer_lock(landmarks_folder(bare)):
        answer = opened(bare, around_s=0.2).localize(path, top=3)
    assert "another process" in answer.note
    assert answer.hypotheses[0].camera is None
    assert parts(bare) == []


def test_photos_that_cannot_be_joined_are_tried_once(bare, query, monkeypatch):
    path, _ = query
    monkeypatch.setattr(on_demand, "reconstruct", only_two_photos(on_demand.reconstruct))
    for _ in range(2):
        answer = opened(bare).localize(path, top=3)
        assert answer.note == "too few landmarks around this place agree with the photo"
        assert answer.hypotheses[0].camera is None
    assert len(parts(bare)) == 1


@pytest.fixture
def tried(tmp_path, monkeypatch):
    """Attempts to join photos of a map, by name, with stand-ins for slow steps."""
    cfg = tmp_path / "map.cfg"

    def run(names, *, joined):
        found = SimpleNamespace(submodels=("a piece",) if joined else ())
        monkeypatch.setattr(on_demand, "reconstruct", lambda *_, **__: found)
        monkeypatch.setattr(on_demand, "adjust_submodels", lambda *_, **__: None)
        the_map = Map(SatelliteImage("s.png", 9, 9), ())
        return on_demand.reconstruct_part(
            cfg, the_map, photos=photos_of(names), settings=Settings(), progress=Progress()
        )

    return SimpleNamespace(cfg=cfg, run=run)


def photos_of(names):
    return [Experience(number, name, MapPixel(1.0, 1.0)) for number, name in enumerate(names)]


def test_photos_that_could_not_be_joined_say_nothing_of_others_around_them(tried):
    folder = tried.run("abcdefghij", joined=False)
    assert on_demand.part_of(tried.cfg, photos_of("jihgfedcba")) == folder
    assert on_demand.part_of(tried.cfg, photos_of("abcdefghi")) is None
    assert on_demand.part_around(tried.cfg, photos_of("abc")) is None
    joined = tried.run("abcx", joined=True)
    assert on_demand.part_around(tried.cfg, photos_of("abc")) == joined


def test_the_oldest_parts_make_room(tried, monkeypatch):
    monkeypatch.setattr(on_demand, "MOST_PARTS", 2)
    folders = [tried.run(names, joined=True) for names in ("ab", "cd")]
    for age, folder in enumerate(reversed(folders)):
        os.utime(folder, (1000.0 - age, 1000.0 - age))
    newest = tried.run("ef", joined=True)
    assert sorted(newest.parent.iterdir()) == sorted([folders[1], newest])


def only_two_photos(reconstruct_all):
    def reconstruct_two(cfg, the_map, **options):
        some = replace(the_map, experiences=the_map.experiences[:2])
        return reconstruct_all(cfg, some, **options)

    return reconstruct_two


def test_all_photos_together_replace_the_parts(bare, query):
    path, at = query
    opened(bare).localize(path, top=1)
    reconstruct(bare, read_map(bare), settings=Settings(), progress=Progress())
    assert (landmarks_folder(bare) / CLOUD_FILE).exists()
    assert parts(bare) == []
    localizer = opened(bare)
    assert localizer.looks[0].around is None
    assert np.hypot(*(localizer.localize(path, top=1).hypotheses[0].position - at)) < 0.2 * PIXELS_PER_METRE


def test_photos_are_chosen_by_what_they_share_and_not_too_many(bare):
    pipeline = opened(bare)
    ids = [e.id for e in pipeline.map.experiences]
    chosen = photos_around(pipeline.opened, [ids[2]], count=4)
    assert chosen[0] == ids[2]
    assert len(chosen) == len(set(chosen)) == 4
    assert max(abs(ids.index(id) - 2) for id in chosen) <= 3
    assert sorted(photos_around(pipeline.opened, [ids[2]], count=100)) == sorted(ids)
