"""Figures of the benchmark of local reconstructions, and its choice between answers."""

import pytest

pytest.importorskip("pycolmap")

from benchmarks import local_reconstructions
from benchmarks.local_reconstructions import Measured, Solved

pytestmark = pytest.mark.slow

TRUTH = (0.0, 0.0)


@pytest.mark.parametrize(
    ("answer", "piece", "position"),
    [
        ((20.0, 0.0), Solved((12.0, 0.0), 40), (12.0, 0.0)),
        ((20.0, 0.0), Solved((12.0, 0.0), 39), (20.0, 0.0)),  # too few landmarks agree
        ((20.0, 0.0), Solved((31.0, 0.0), 90), (20.0, 0.0)),  # another place
        ((20.0, 0.0), None, (20.0, 0.0)),
        (None, None, None),
    ],
)
def test_a_piece_answers_where_enough_landmarks_agree_in_the_same_place(answer, piece, position):
    assert Measured(TRUTH, answer, piece).position(40, place_radius_px=10.0) == position


def test_shares_are_of_all_queries():
    measured = [
        Measured(TRUTH, (20.0, 0.0), Solved((9.0, 0.0), 50)),
        Measured(TRUTH, (0.0, 21.0), None),
        Measured(TRUTH, None, None),
    ]
    found = local_reconstructions.shares(measured, 40, unit=10.0, place_radius_px=30.0)
    assert found["within_1"] == pytest.approx(1 / 3)
    assert found["within_5"] == pytest.approx(2 / 3)
    assert (found["taken"], found["median_without"], found["median_with"]) == (1, 2.0, 0.9)


def test_the_common_error_is_that_of_the_true_position():
    off = [(3.0 + x, 4.0 + y) for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))]
    measured = [Measured(TRUTH, None, Solved(at, 50)) for at in off]
    # the four deviations add up to zero, so that their inner products are -1/3 on average
    found = local_reconstructions.common_error(measured, 40, within=20.0)
    assert found == pytest.approx((25.0 - 1 / 3) ** 0.5)
    assert local_reconstructions.common_error(measured[:1], 40, within=20.0) is None
