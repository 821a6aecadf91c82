"""The sample map: complete, correct, reproducible, and made robustly."""

import csv
import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from webapp.app.main import root
from webapp.errors import Cancelled, UsageError
from webapp.files.localize import queries_csv
from webapp.files.maps.folder import read_map
from webapp.files.photos.photo import read_facts, read_gray
from webapp.progress import Progress
from webapp.sample import make as make_sample
from webapp.sample.make import FOV_DEG, OFF_MAP, SampleSize
from webapp.settings import Settings
from webapp.tasks.maps import check_map, from_photos
from webapp.tasks.satellite.georeference import GeoSource

SMALL = SampleSize(photos=2, queries=1, width=160, metres_per_pixel=0.5)
METRES_PER_PIXEL = 0.12
SETTINGS = Settings()


def make(folder, **options):
    return make_sample.make_sample(folder, settings=SETTINGS, progress=Progress(), **options)


def content(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small") / "sample"
    assert make(folder, size=SMALL).made
    return folder


def test_the_map_is_clean(sample_folder):
    report = check_map.check_map(sample_folder / "map.cfg", settings=SETTINGS, progress=Progress())
    assert (report.photos, report.errors) == (60, 0)
    # the queries are intentionally in a folder outside the map
    assert [f.message for f in report.findings if "'queries/" not in f.message] == []


def test_every_photo_says_where_it_is(sample_folder):
    map_ = read_map(sample_folder / "map.cfg")
    assert (map_.satellite.width, map_.satellite.height) == (1000, 750)
    for experience in map_.experiences:
        facts = read_facts(sample_folder / experience.photo, limits=SETTINGS.photo)
        assert (facts.width, facts.height) == (640, 480)
        seen = map_.georeference.pixel_of((facts.gps.lat, facts.gps.lon))
        assert seen == pytest.approx(experience.position, abs=0.01)
        assert facts.heading_deg == pytest.approx(experience.heading_deg, abs=0.001)
        assert facts.heading.reference == "T"
        assert facts.fov_deg == pytest.approx(experience.fov_deg, abs=0.01)
        assert facts.gps.accuracy_m == experience.gps_accuracy_m
        assert facts.taken_at == experience.taken_at
        assert facts.notes == ()


def test_the_satellite_image_is_a_hundred_and_twenty_metres_wide(sample_folder):
    map_ = read_map(sample_folder / "map.cfg")
    assert map_.georeference.metres_per_pixel((500.0, 375.0)) == pytest.approx(METRES_PER_PIXEL, rel=1e-4)
    assert map_.georeference.north_deg((500.0, 375.0)) == pytest.approx(0, abs=0.01)


def test_the_photos_make_the_map_again(sample_folder, tmp_path):
    options = from_photos.PlaceOptions(
        tmp_path / "again" / "map.cfg",
        satellite=sample_folder / "satellite.png",
        source=GeoSource("corners", sample_folder / "corners.json"),
        copy=True,
    )
    options.cfg.parent.mkdir()
    from_photos.map_from_photos(
        sample_folder / "photos", options=options, settings=SETTINGS, progress=Progress()
    )
    again, truth = read_map(options.cfg), read_map(sample_folder / "map.cfg")
    assert len(again.experiences) == 60
    for ours, theirs in zip(truth.experiences, again.experiences, strict=True):
        assert theirs.position == pytest.approx(ours.position, abs=0.01)
        assert theirs.heading_deg == pytest.approx(ours.heading_deg, abs=0.001)
        assert theirs.fov_deg == pytest.approx(ours.fov_deg, abs=0.01)


def test_the_queries_are_on_the_map_and_do_not_say_where(sample_folder):
    queries = queries_csv.read(sample_folder / "queries.csv")
    record = json.loads((sample_folder / "sample.json").read_text("utf-8"))
    assert len(queries) == 11
    assert {query["light"] for query in record["queries"]} == {"afternoon", "evening", "autumn", "overcast"}
    for query, truth in zip(queries, record["queries"], strict=True):
        assert (query.name, *query.truth) == (truth["path"], truth["x"], truth["y"])
        assert 0 < query.truth.x < 1000 and 0 < query.truth.y < 750
        facts = read_facts(query.path, limits=SETTINGS.photo)
        assert not facts.gps
        assert facts.heading is None
        assert facts.fov_deg == pytest.approx(FOV_DEG, abs=0.01)


def test_the_photo_from_elsewhere_has_no_place_in_the_list(sample_folder):
    assert not read_facts(sample_folder / OFF_MAP, limits=SETTINGS.photo).gps
    with (sample_folder / "queries.csv").open(encoding="utf-8", newline="") as file:
        assert OFF_MAP not in [row[0] for row in csv.reader(file, delimiter=";")]


def describe(path):
    photo = read_gray(path, limits=SETTINGS.photo, max_side=480)  # smaller is faster, and harder
    keypoints, descriptors = cv2.SIFT_create(600).detectAndCompute(photo.pixels, None)
    return np.array([keypoint.pt for keypoint in keypoints]) / photo.scale, descriptors


def agreeing(first, second):
    """Return mutual best matches that agree on one essential matrix."""
    pairs = cv2.BFMatcher(crossCheck=True).match(first[1], second[1])
    pairs = [pair for pair in pairs if pair.distance < 260]
    if len(pairs) < 8:
        return 0
    xy1 = first[0][[pair.queryIdx for pair in pairs]]
    xy2 = second[0][[pair.trainIdx for pair in pairs]]
    focal = 320 / np.tan(np.radians(FOV_DEG / 2))
    camera = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    cv2.setRNGSeed(7)
    _, inlier = cv2.findEssentialMat(xy1, xy2, camera, cv2.RANSAC, 0.999, 1.0)
    return 0 if inlier is None else int(inlier.sum())


def test_places_look_different(sample_folder):
    map_ = read_map(sample_folder / "map.cfg")
    photos = [describe(sample_folder / e.photo) for e in map_.experiences]
    owner = np.concatenate([np.full(len(d), number) for number, (_, d) in enumerate(photos)])
    flann = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 4}, {"checks": 64})
    flann.add([np.concatenate([descriptors for _, descriptors in photos])])
    flann.train()

    def voted(query):
        hits = [best for (best,) in flann.knnMatch(query[1], k=1)]
        mean = np.mean([hit.distance for hit in hits])
        near = [hit.trainIdx for hit in hits if hit.distance <= mean]
        return int(np.bincount(owner[near], minlength=len(photos)).argmax())

    right, verified = 0, []
    for query in queries_csv.read(sample_folder / "queries.csv"):
        seen = describe(query.path)
        best = voted(seen)
        off = np.subtract(map_.experiences[best].position, query.truth) * METRES_PER_PIXEL
        right += bool(np.hypot(*off) < 12)
        verified.append(agreeing(seen, photos[best]))
    assert right >= 9
    elsewhere = describe(sample_folder / OFF_MAP)
    alike = agreeing(elsewhere, photos[voted(elsewhere)])
    assert alike < min(verified)
    assert alike < 0.3 * np.median(verified)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(small, tmp_path):
    make(tmp_path / "again", size=SMALL)
    first, second = content(small), content(tmp_path / "again")
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []
    record = json.loads(first["sample.json"])
    assert sorted([*record["files"], "sample.json"]) == sorted(first)


def test_a_sample_that_is_there_is_left_alone(small):
    before = {path: path.stat().st_mtime_ns for path in small.rglob("*")}
    assert not make(small, size=SMALL).made
    assert {path: path.stat().st_mtime_ns for path in small.rglob("*")} == before


def test_a_folder_with_something_else_is_never_overwritten(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    for force in (False, True):
        with pytest.raises(UsageError, match="not a sample"):
            make(tmp_path, size=SMALL, force=force)
    assert content(tmp_path) == {"thesis.txt": b"years of work"}


def test_another_seed_needs_force(small):
    with pytest.raises(UsageError, match="force"):
        make(small, size=SMALL, seed=8)


def test_a_damaged_record_is_reported(tmp_path):
    (tmp_path / "sample.json").write_text('{"recipe":')
    with pytest.raises(UsageError, match="damaged"):
        make(tmp_path, size=SMALL)


class Stopping(Progress):
    """A progress that stops after the first picture, and counts."""

    def __init__(self):
        self.done, self.total = 0, 0

    def size(self, total):
        self.total = total

    def advance(self, steps=1):
        self.done += steps

    def cancelled(self):
        return self.done >= 1


def test_stopping_leaves_nothing_behind(tmp_path):
    progress = Stopping()
    with pytest.raises(Cancelled):
        make_sample.make_sample(tmp_path / "sample", settings=SETTINGS, progress=progress, size=SMALL)
    assert progress.total == SMALL.photos + SMALL.queries + 2
    assert list(tmp_path.iterdir()) == []


def test_force_replaces_and_a_missing_file_is_made_again(tmp_path, monkeypatch):
    """The content is irrelevant here, so a stand-in writes only one file."""

    def write(folder, **_):
        folder.mkdir()
        (folder / "map.cfg").write_text("map")
        return {"files": ["map.cfg"]}

    monkeypatch.setattr(make_sample, "write_sample", write)
    folder = tmp_path / "sample"
    assert make(folder).made
    (folder / "derived").mkdir()
    assert make(folder, force=True, seed=3).made
    assert not (folder / "derived").exists()
    (folder / "map.cfg").unlink()
    assert make(folder, seed=3).made
    assert (folder / "map.cfg").read_text() == "map"
    assert [path.name for path in tmp_path.iterdir()] == ["sample"]


def test_the_command_prints_the_map(sample_folder, small):
    result = CliRunner().invoke(root, ["sample", "--library", str(sample_folder.parent)])
    assert result.exit_code == 0
    assert result.stdout == f"{sample_folder / 'map.cfg'}\n"
    assert "already" in result.stderr
    result = CliRunner().invoke(root, ["sample", str(small)])  # made in another size
    assert isinstance(result.exception, UsageError)
