"""Photos of six cameras are joined to panoramas, which are marked as such."""

from dataclasses import replace
from datetime import datetime, timedelta, timezone

import cv2
import numpy as np
import piexif
import pytest

from tests.core.geometry.rig_photos import FOV_DEG, SIX, photo_of
from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.files.photos.panorama import MountedCamera, find_panorama, read_mask
from webapp.files.photos.photo import read_facts, read_upright
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.maps.panoramas import JoinOptions, join_panoramas

LIMITS = PhotoLimits()
CAMERAS = [MountedCamera(f"cam{n}/*.jpg", *mounted, FOV_DEG) for n, mounted in enumerate(SIX)]
TAKEN = datetime(2026, 5, 1, 12, 30, 7, 40_000, timezone(-timedelta(hours=3, minutes=30)))
TAGS = CameraTags(TAKEN, None, LatLon(50.0, 14.5), heading_deg=100.0, accuracy_m=2.5)
SPOT = (75.0, 10.0)


@pytest.fixture
def survey(tmp_path):
    """A folder with photos of six cameras at two times; those of the second camera have EXIF."""
    for number, mounted in enumerate(SIX):
        folder = tmp_path / "survey" / f"cam{number}"
        folder.mkdir(parents=True)
        for instant in ("7", "12"):
            path = folder / f"{instant}.jpg"
            cv2.imwrite(str(path), photo_of([SPOT], mounted, wide=160, high=130))
            if number == 1:
                piexif.insert(exif_bytes(TAGS), str(path))
    return tmp_path / "survey"


def join(folder, cameras=CAMERAS, **options):
    out = folder.parent / "out"
    options = JoinOptions(**options)
    return [
        *join_panoramas(folder, out, cameras=cameras, options=options, limits=LIMITS, progress=Progress())
    ]


def test_the_panoramas_are_whole_and_have_time_place_and_heading(survey):
    done = join(survey)
    assert [(one.panorama, one.is_new, one.problem) for one in done] == [
        ("7.jpg", True, ""),
        ("12.jpg", True, ""),
    ]
    assert done[0].photos == tuple(f"cam{n}/7.jpg" for n in range(6))
    path = survey.parent / "out" / "7.jpg"
    facts = read_facts(path, limits=LIMITS)
    assert find_panorama(path, facts, limits=LIMITS).heading_deg == pytest.approx(40.0)
    assert facts.heading.deg == pytest.approx(40.0)
    assert (facts.gps.lat, facts.gps.lon) == pytest.approx((50.0, 14.5), abs=1e-6)
    assert facts.gps.accuracy_m == pytest.approx(2.5)
    assert datetime.fromisoformat(facts.taken_at) == TAKEN
    assert facts.taken_at.endswith("-03:30")
    light = read_upright(path, limits=LIMITS)[..., 0]
    row, column = np.unravel_index(light.argmax(), light.shape)
    high, wide = light.shape
    assert wide == 2 * high
    assert ((column + 0.5) / wide - 0.5) * 360.0 == pytest.approx(SPOT[0], abs=0.7)
    assert (0.5 - (row + 0.5) / high) * 180.0 == pytest.approx(SPOT[1], abs=0.7)


def test_what_is_there_is_not_made_again_unless_photos_or_rig_are_others(survey):
    join(survey)
    assert [one.is_new for one in join(survey)] == [False, False]
    cv2.imwrite(str(survey / "cam3" / "12.jpg"), np.full((130, 160, 3), 90, np.uint8))
    assert [one.is_new for one in join(survey)] == [False, True]
    (survey.parent / "out" / "7.jpg").write_bytes(b"cut")
    assert [one.is_new for one in join(survey)] == [True, False]
    turned = [replace(camera, yaw_deg=camera.yaw_deg + 1.0) for camera in CAMERAS]
    assert [one.is_new for one in join(survey, turned)] == [True, True]


def test_an_instant_that_cannot_be_joined_says_why_and_the_others_are(survey):
    (survey / "cam2" / "7.jpg").unlink()
    (survey / "cam4" / "12.jpg").write_bytes(b"no photo")
    cv2.imwrite(str(survey / "cam0" / "13.jpg"), np.zeros((130, 160, 3), np.uint8))
    problems = {one.panorama: one.problem for one in join(survey)}
    assert problems["7.jpg"] == "no photo of the camera cam2/*.jpg"
    assert problems["12.jpg"].startswith("cam4/12.jpg: ")
    assert problems["13.jpg"] == "no photo of the camera cam1/*.jpg"
    assert not (survey.parent / "out").exists()


def test_a_field_of_view_that_nobody_knows(survey):
    unknown = [replace(camera, fov_deg=None) for camera in CAMERAS]
    assert {one.problem for one in join(survey, unknown)} == {
        f"cam0/{n}.jpg: its field of view is not known (give fov_deg in the rig's file)" for n in (7, 12)
    }


def test_the_mask_is_what_no_camera_sees(survey):
    mask = survey.parent / "mask.png"
    join(survey, mask=mask, width=360)
    boxes = read_mask(mask, limits=LIMITS)
    covered = sum(box.width * box.height for box in boxes)
    assert 0.4 < covered < 0.65
    assert read_upright(survey.parent / "out" / "7.jpg", limits=LIMITS).shape == (180, 360, 3)


def test_wrong_folders(survey):
    with pytest.raises(UsageError, match="no photo of the camera other"):
        join(survey, [*CAMERAS, MountedCamera("other/*.jpg", 0.0, 0.0, 0.0, 80.0)])
    with pytest.raises(UsageError, match="among the photos"):
        [
            *join_panoramas(
                survey,
                survey / "out",
                cameras=CAMERAS,
                options=JoinOptions(),
                limits=LIMITS,
                progress=Progress(),
            )
        ]
