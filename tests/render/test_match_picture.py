import numpy as np
import pytest

from webapp.core.hypotheses.model import Evidence
from webapp.render.answer_pictures import BAND_PX, GAP_PX, HEIGHT_PX, WIDTH_PX, draw_matches
from webapp.render.colours import INLIER


def grey(width: int, height: int, value: int) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def evidence(query: list, photo: list, inlier: list) -> Evidence:
    return Evidence(7, np.array(query, np.float32), np.array(photo, np.float32), np.array(inlier, bool))


def picture(query: np.ndarray, photo: np.ndarray, found: Evidence) -> np.ndarray:
    return np.array(draw_matches(query, photo, evidence=found, query_name="q.jpg", photo_name="p.jpg"))


def test_inlier_is_a_strong_line_from_keypoint_to_keypoint() -> None:
    # 640 is the drawn height, so nothing is scaled and coordinates are those of the photos
    drawn = picture(grey(700, 640, 90), grey(700, 640, 90), evidence([[100, 200]], [[300, 400]], [True]))
    start, end = np.array([100, 200]), np.array([300 + 700 + GAP_PX, 400])
    for at in (0.02, 0.5, 0.98):
        x, y = np.rint(start + at * (end - start)).astype(int)
        near = drawn[y - 1 : y + 2, x].astype(int)
        assert np.abs(near - INLIER).sum(axis=1).min() < 120
    assert (drawn[300, 100] == 90).all()
    assert np.abs(drawn[199:202, 103:105].astype(int) - INLIER).sum(axis=2).min() < 120


def test_other_matches_are_faint_and_inliers_are_not() -> None:
    both = evidence([[100, 100], [100, 500]], [[100, 100], [100, 500]], [True, False])
    drawn = picture(grey(700, 640, 90), grey(700, 640, 90), both).astype(int)
    strong, faint = drawn[100, 500] - 90, drawn[500, 500] - 90
    assert np.abs(strong).max() > 120
    assert 10 < np.abs(faint).max() < 80


def test_plain_matches_are_well_seen_when_no_geometry_was_found() -> None:
    drawn = picture(grey(700, 640, 90), grey(700, 640, 90), evidence([[100, 500]], [[100, 500]], [False]))
    assert drawn[500, 500].max() > 180


@pytest.mark.parametrize(
    ("query", "photo"), [((4000, 3000), (300, 900)), ((64, 48), (64, 48)), ((30, 2), (2, 30))]
)
def test_any_sizes_share_one_height_and_fit(query: tuple[int, int], photo: tuple[int, int]) -> None:
    drawn = picture(grey(*query, 20), grey(*photo, 200), evidence([[1, 1]], [[1, 1]], [True]))
    height, width = drawn.shape[0] - BAND_PX, drawn.shape[1]
    assert height <= HEIGHT_PX
    assert width <= WIDTH_PX + 1
    left = round(query[0] * height / query[1])
    assert abs(int(drawn[height // 2, left // 2].max()) - 20) < 60
    assert abs(int(drawn[height - 2, -2].min()) - 200) < 60


def test_no_match_at_all_is_two_photos() -> None:
    none = evidence(np.zeros((0, 2)).tolist(), np.zeros((0, 2)).tolist(), [])
    empty = Evidence(7, none.query_xy.reshape(0, 2), none.photo_xy.reshape(0, 2), none.inlier)
    drawn = picture(grey(700, 640, 90), grey(700, 640, 90), empty)
    assert (drawn[:640, :700] == 90).all()


def test_blue_green_red_comes_out_as_red_green_blue() -> None:
    red = np.zeros((640, 640, 3), np.uint8)
    red[..., 2] = 255
    drawn = picture(red, red, evidence([[1, 1]], [[1, 1]], [True]))
    assert tuple(drawn[600, 300]) == (255, 0, 0)
