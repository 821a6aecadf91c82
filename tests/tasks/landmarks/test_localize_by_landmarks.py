"""Photos of the rendered court are localized by its landmarks."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.conftest import textured
from tests.tasks.landmarks.rendered import FOV_DEG, PIXELS_PER_METRE, SIDE, render
from webapp.core.hypotheses.jsonform import answer_to_json
from webapp.core.hypotheses.model import AnswerSource
from webapp.errors import UsageError
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud, write_cloud
from webapp.files.landmarks.colmap import SUBMODELS_FILE
from webapp.files.localize.arrays import read_arrays, write_arrays
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import LandmarkSettings, Settings
from webapp.tasks.landmarks.accept import accept_in_folder
from webapp.tasks.landmarks.place_rest import suggest_rest
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

OPTIONS = OpenOptions(method="landmarks")


NONE_AROUND = Settings(landmarks=LandmarkSettings(around_s=0.0))


def open_court(cfg, **options):
    return open_pipeline(cfg, replace(OPTIONS, **options), settings=NONE_AROUND, progress=Progress())


@pytest.fixture(scope="module")
def localizer(joined_court, tmp_path_factory):
    """The opened court with all its photos placed; read-only."""
    folder = tmp_path_factory.mktemp("landmarks") / "court"
    shutil.copytree(joined_court.cfg.parent, folder)
    cfg = folder / "map.cfg"
    accept_in_folder(cfg, suggest_rest(cfg, settings=Settings(), progress=Progress()).suggested)
    the_map = read_map(cfg)
    by_hand = tuple(replace(e, radius_px=None) for e in the_map.experiences)
    write_map(cfg, replace(the_map, experiences=by_hand))
    return open_court(cfg)


def photo_at(tmp_path, angle, *, aside, turned):
    x, y = SIDE / 2 + (4.0 + aside) * np.cos(angle), SIDE / 2 + (3.0 + aside) * np.sin(angle)
    heading = angle - np.pi / 2 + 0.4 + turned
    path = tmp_path / "query.png"
    cv2.imwrite(str(path), render(x, y, heading))
    return path, np.array([x, y]) * PIXELS_PER_METRE, np.degrees(heading)


def test_a_camera_is_within_a_decimetre_and_a_fifth_of_a_degree(localizer, tmp_path):
    metres, degrees = [], []
    for angle, aside, turned in [(0.5, 0.3, 0.1), (0.9, -0.4, 0.0), (1.2, 0.2, -0.15), (1.6, 0.0, 0.1)]:
        path, at, heading = photo_at(tmp_path, angle, aside=aside, turned=turned)
        first = localizer.localize(path, top=3).hypotheses[0]
        assert first.kind == "position"
        assert first.probability > 0.9
        metres.append(np.hypot(*(first.position - at)) / PIXELS_PER_METRE)
        degrees += [(first.heading_deg - heading + 180.0) % 360.0 - 180.0]
        degrees += [first.camera.pitch_deg, first.camera.roll_deg]
        assert abs(first.camera.height_px) < 0.1 * PIXELS_PER_METRE
        assert first.camera.landmarks > 100
        spread = np.sqrt(np.diag(first.camera.covariance))
        assert (spread[:3] < 0.2 * PIXELS_PER_METRE).all()
        assert (spread[3:] < 0.2).all()
    assert np.median(metres) <= 0.1
    assert np.median(np.abs(degrees)) <= 0.2


def test_the_answer_has_the_fields_of_the_others_and_the_camera(localizer, tmp_path):
    path, _, _ = photo_at(tmp_path, 0.9, aside=0.1, turned=0.0)
    answer = localizer.localize(path, top=1)
    source = AnswerSource(localizer.method, localizer.features, None, 1)
    form = json.loads(json.dumps(answer_to_json(answer, query="q", source=source)))
    (first,) = form["hypotheses"]
    assert form["method"] == "landmarks"
    assert first["inliers"] > 50
    assert set(first["camera"]) == {
        "height_px", "height_m", "pitch_deg", "roll_deg", "covariance", "landmarks",
    }  # fmt: skip
    assert first["camera"]["height_m"] is None
    assert np.array(first["camera"]["covariance"]).shape == (6, 6)
    assert len(answer.evidence[0].query_xy) == first["matches"]


def test_a_photo_from_elsewhere_is_not_on_the_map(localizer, tmp_path):
    path = tmp_path / "elsewhere.png"
    cv2.imwrite(str(path), textured(77, width=400, height=300))
    answer = localizer.localize(path, top=3)
    assert answer.hypotheses == ()
    assert answer.off_map_probability == 1.0
    assert answer.no_pose.reason == "too few matching landmarks"


def test_hidden_photos_say_nothing(localizer, tmp_path):
    path, at, _ = photo_at(tmp_path, 0.9, aside=0.0, turned=0.0)
    ids = [e.id for e in localizer.map.experiences]
    first = localizer.localize(path, top=1, hide=frozenset(ids[3:6])).hypotheses[0]
    assert not {*first.experiences} & {*ids[3:6]}
    assert np.hypot(*(first.position - at)) < 0.3 * PIXELS_PER_METRE
    assert localizer.localize(path, top=1, hide=frozenset(ids[1:])).hypotheses == ()


def test_a_lens_that_is_stated_wrongly_is_that_of_the_photos(localizer, tmp_path):
    path, at, _ = photo_at(tmp_path, 0.9, aside=0.2, turned=0.0)
    wrong = replace(localizer, fov_deg=FOV_DEG + 8.0)
    first = wrong.localize(path, top=1).hypotheses[0]
    assert np.hypot(*(first.position - at)) < 0.1 * PIXELS_PER_METRE


def cloud_path(cfg: Path) -> Path:
    return landmarks_folder(cfg) / CLOUD_FILE


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda file: file.unlink(), "the map has no landmarks"),
        (
            lambda file: file.write_bytes(b"EXPMAP1\nnothing"),
            "the landmarks of the map are of another version",
        ),
        (
            lambda file: write_arrays(file, read_arrays(file, mapped=False)[0], meta={"format": 99}),
            "the landmarks of the map are of another version",
        ),
        (
            lambda file: write_cloud(file, replace(read_cloud(file), key="another")),
            "the landmarks of the map are of another version",
        ),
    ],
)
def test_landmarks_that_do_not_fit_are_refused(court, spoil, problem):
    spoil(cloud_path(court.cfg))
    with pytest.raises(UsageError, match=problem) as caught:
        open_court(court.cfg)
    assert "expmap landmarks build" in caught.value.hint


def test_landmarks_that_are_missing_are_gathered_from_the_models(court):
    file = cloud_path(court.cfg)
    before = read_cloud(file).cloud
    points = np.array(before.point)
    file.unlink()
    suggest_rest(court.cfg, settings=Settings(), progress=Progress())
    np.testing.assert_array_equal(read_cloud(file).cloud.point, points)
    assert (file.parent / SUBMODELS_FILE).exists()


def test_photos_without_landmarks_are_named(court):
    notes: list[str] = []

    class Noted(Progress):
        def note(self, text: str) -> None:
            notes.append(text)

    folder = court.cfg.parent
    cv2.imwrite(str(folder / "photos" / "new.png"), textured(31, width=400, height=300))
    with court.cfg.open("a") as lines:
        lines.write("77;photos/new.png;30;30\n")
    open_pipeline(court.cfg, OPTIONS, settings=Settings(), progress=Noted())
    assert any(note.startswith("1 photos of the map show no landmarks") for note in notes)


def test_only_sift_describes_landmarks(court):
    with pytest.raises(UsageError, match="landmarks are described by sift, not by orb"):
        open_court(court.cfg, features="orb")
