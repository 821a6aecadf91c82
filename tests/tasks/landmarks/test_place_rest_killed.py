"""Placing the rest is killed at every step: the next run goes on there, and ends with the same places."""

import shutil
from contextlib import contextmanager
from dataclasses import replace

import pytest

from tests.killing import Step, die, run_until
from tests.tasks.landmarks.conftest import few_keypoints
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, facts_of
from webapp.files.landmarks.colmap import pycolmap
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import mapping, stored
from webapp.tasks.landmarks.place_rest import suggest_rest
from webapp.tasks.localize.index_location import landmarks_folder

pytestmark = pytest.mark.slow

MORE_PLACED = (2, 6)
"""Photos that are placed besides those of the court: enough for an adjustment."""

RECONSTRUCT, ADJUST = "webapp.tasks.landmarks.reconstruct", "webapp.tasks.landmarks.adjust"

STEPS = [
    Step("webapp.progress:Progress.advance", calls=3),
    Step("webapp.files.landmarks.match_database:MatchDatabase._write_frame", calls=4),
    Step("webapp.files.landmarks.match_database:MatchDatabase.keep", calls=5),
    Step(f"{RECONSTRUCT}:write_submodels"),
    Step(f"{RECONSTRUCT}:write_submodels", is_after=True),
    Step(f"{RECONSTRUCT}:write_cloud"),
    Step(f"{ADJUST}:run_adjustment", is_after=True),
    Step(f"{ADJUST}:write_submodels", is_after=True),
    Step("webapp.tasks.landmarks.colours:write_colours"),
    Step("webapp.tasks.landmarks.stored:write_text"),
    Step("webapp.tasks.landmarks.stored:write_text", is_after=True),
]
"""In the order of the work, each of which begins where the last one was killed."""


def work(cfg, progress=None):
    """Suggest places and store them, as the job does."""
    with few_keypoints():
        report = suggest_rest(cfg, settings=Settings(), progress=progress or Progress())
    stored.keep(cfg, report, revision=1)


class DiesWhileMapping(Progress):
    """Kills its process while another one joins the photos."""

    def __init__(self, models):
        self._models = models

    def check(self):
        if self._models.is_dir():
            die()


def work_until_mapping(cfg):
    mapping._LOOK_EVERY_S = 0.01
    work(cfg, DiesWhileMapping(landmarks_folder(cfg) / "models"))


@pytest.fixture
def wide(court):
    """The court with more placed photos."""
    the_map = read_map(court.cfg)
    placed = [
        Experience(p.id, p.photo, MapPixel(*court.at[p.id]), **facts_of(p))
        for p in the_map.unplaced
        if p.id in MORE_PLACED
    ]
    everyone = tuple(sorted((*the_map.experiences, *placed), key=lambda e: e.id))
    rest = tuple(p for p in the_map.unplaced if p.id not in MORE_PLACED)
    write_map(court.cfg, replace(the_map, experiences=everyone, unplaced=rest))
    return court.cfg


def numbers(content):
    """Return the positions, radii and headings of all photos of suggestions."""
    return {
        f"{photo['id']}: {name}": value
        for photo in (*content["photos"], *content["checked"])
        for name, value in photo.items()
        if isinstance(value, float)
    }


def described(folder):
    """Return when the features of each photo were written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.rglob("*.features")}


@contextmanager
def unchanged(cfg):
    """Check that the map itself stays as it is."""
    before = cfg.read_bytes(), cfg.with_name("map.json").read_bytes()
    yield
    assert (cfg.read_bytes(), cfg.with_name("map.json").read_bytes()) == before


def test_it_goes_on_after_each_kill_and_ends_with_the_same_places(wide, tmp_path, counted):
    cfg = shutil.copytree(wide.parent, tmp_path / "killed") / "map.cfg"
    work(wide)
    undisturbed = stored.read(wide)
    assert [photo["id"] for photo in undisturbed["photos"] if "error" not in photo] == [1, 3, 5, 7]
    folder = landmarks_folder(cfg)
    shutil.rmtree(folder)
    with unchanged(cfg):
        for step in STEPS[:3]:
            assert run_until(step, work, cfg), step
            assert stored.read(cfg) is None
        photos = described(folder)
        assert len(photos) == 10
        (folder / "spool" / ".half.features.0.tmp").write_bytes(b"of a writer that was killed")
        assert run_until(Step("webapp.tasks.landmarks.stored:keep"), work_until_mapping, cfg)
        assert not (folder / "pieces.arrays").exists(), "it was killed while the photos were joined"
        for step in STEPS[3:]:
            assert run_until(step, work, cfg), step
            assert (stored.read(cfg) is None) == (step is not STEPS[-1]), step
        last = counted()
        work(cfg, last)
    assert described(folder) == photos, "no photo is described again"
    assert last.sizes == [10, 0], "no pair is compared again"
    again = stored.read(cfg)
    assert numbers(again) == pytest.approx(numbers(undisturbed), abs=0.05)
    assert [photo["id"] for photo in again["photos"]] == [photo["id"] for photo in undisturbed["photos"]]
    assert len(numbers(again)) > 20
    assert not list(folder.rglob("*.tmp"))


def in_models(cfg):
    """Return the photos in the models of the mappers."""
    folders = mapping.model_folders(landmarks_folder(cfg))
    return {image.name for one in folders for image in pycolmap().Reconstruction(one).images.values()}


def test_pieces_do_not_stay_with_the_models_of_other_photos(court):
    joined, the_map = in_models(court.cfg), read_map(court.cfg)
    assert len(joined) == 9
    write_map(court.cfg, replace(the_map, unplaced=tuple(p for p in the_map.unplaced if p.id != 3)))
    assert run_until(Step(f"{RECONSTRUCT}:write_submodels"), work, court.cfg)
    assert len(in_models(court.cfg)) == 8
    write_map(court.cfg, the_map)
    work(court.cfg)
    assert in_models(court.cfg) == joined
