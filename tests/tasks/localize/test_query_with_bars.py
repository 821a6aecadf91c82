"""A screenshot of a photo: its bars are cut off before anything, and matches are in pixels of the file."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.opening import open_first_look
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.query_photo import read_query

TOP, BOTTOM = 150, 250


@pytest.fixture
def shot(make_map, tmp_path):
    """A map, and its first photo with bars above and below."""
    cfg = make_map(tmp_path / "map", 3)
    photo = cv2.imread(str(cfg.parent / "photos" / "1.jpg"))
    path = tmp_path / "shot.png"
    cv2.imwrite(
        str(path), cv2.copyMakeBorder(photo, TOP, BOTTOM, 0, 0, cv2.BORDER_CONSTANT, value=(20, 20, 20))
    )
    return cfg, path, photo.shape[:2]


def test_the_photo_inside_is_read_with_its_own_field_of_view(shot):
    _, path, (height, width) = shot
    (query,) = read_query(path, settings=Settings(), fov_deg=None, describe=None)
    assert query.gray.full_size == (width, height) and query.origin == (0, TOP)
    whole = replace(Settings(), extract=replace(Settings().extract, max_side_px=200))
    (small,) = read_query(path, settings=whole, fov_deg=None, describe=None)
    assert abs(small.gray.full_size[1] - height) <= 6 and small.fov.degrees == pytest.approx(
        query.fov.degrees, abs=1
    )


def test_a_stated_field_of_view_is_that_of_the_file(shot, tmp_path):
    _, path, (height, width) = shot
    (query,) = read_query(path, settings=Settings(), fov_deg=60.0, describe=None)
    assert query.fov.degrees == pytest.approx(60.0)  # bars above and below do not change it
    sides = np.pad(cv2.imread(str(path))[TOP : TOP + height], ((0, 0), (width // 2, width // 2), (0, 0)))
    cv2.imwrite(str(tmp_path / "sides.png"), sides)
    (query,) = read_query(tmp_path / "sides.png", settings=Settings(), fov_deg=90.0, describe=None)
    assert query.gray.full_size == (width, height)
    assert query.fov.degrees == pytest.approx(53.13, abs=0.01)


def test_matches_are_in_pixels_of_the_file(shot, quick):
    cfg, path, _ = shot
    opened = open_first_look(cfg, OpenOptions(method="vote"), settings=quick, progress=Progress())
    answer = LocalizationPipeline("vote", (Look(opened),)).localize(path, top=3)
    assert answer.hypotheses[0].experiences[0] == 1
    best = answer.evidence[0]
    assert best.experience == 1
    assert np.median(best.query_xy - best.photo_xy, axis=0).tolist() == pytest.approx([0.0, TOP], abs=0.5)
