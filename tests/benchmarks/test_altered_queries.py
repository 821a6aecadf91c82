"""The alterations of queries are what they say."""

import numpy as np
import pytest

from benchmarks import altered_queries
from webapp.core.features.bars import Inside, inside_bars
from webapp.core.retrieval.fields_of_view import cropped_fov_deg
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits

pytestmark = pytest.mark.slow


@pytest.fixture
def photo():
    return np.random.default_rng(0).integers(0, 256, (90, 160, 3)).astype(np.uint8)


def test_bars_are_those_that_are_cut_off_again(photo):
    shot = altered_queries.with_bars(photo)
    height, width = shot.shape[:2]
    assert width == 160 and height == int(160 * 19.5 / 9.0)
    top = (height - 90) // 2
    assert inside_bars(shot[:, :, 0]) == Inside(0, top, 160, top + 90)


def test_crops_keep_the_middle_and_the_focal_length(photo):
    half = altered_queries.cropped(photo, 0.5)
    assert (half == photo[22:68, 40:120]).all()
    assert cropped_fov_deg(90.0, 0.5) == pytest.approx(53.13, abs=0.01)
    assert altered_queries.zoomed(photo, 2.0).shape == photo.shape


def test_exif_states_the_focal_length_that_is_asked_for(photo, tmp_path):
    focal_px = altered_queries._focal_px(photo, 60.0)
    altered_queries.write_photo(tmp_path / "a.jpg", photo, focal_px=2.0 * focal_px)
    altered_queries.write_photo(tmp_path / "b.jpg", photo, focal_px=None)
    stated = [read_facts(tmp_path / f"{name}.jpg", limits=PhotoLimits()).fov_deg for name in "ab"]
    assert stated == [
        pytest.approx(2.0 * np.degrees(np.arctan(np.tan(np.radians(30.0)) / 2.0)), abs=0.5),
        None,
    ]


def test_each_alteration_gives_a_photo(photo):
    for alteration in altered_queries.ALTERATIONS.values():
        changed = alteration.change(photo)
        assert changed.dtype == np.uint8 and changed.ndim == 3
    assert altered_queries.ALTERATIONS["black"].change(photo).std() < 2
