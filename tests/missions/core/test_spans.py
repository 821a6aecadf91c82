"""Spans of time, of which what overlaps counts once."""

import pytest

from webapp.missions.core.spans import Spans


@pytest.mark.parametrize(
    ("spans", "shares", "length"),
    [
        ([(0, 10), (0, 10)], [1, 0], 10),
        ([(0, 10), (10, 14)], [1, 1], 14),
        ([(0, 10), (9, 14)], [1, 0.8], 14),
        ([(0, 4), (10, 14), (-2, 20), (3, 11)], [1, 1, 14 / 22, 0], 22),
        ([(0, 4), (2, 2), (7, 7), (7, 7)], [1, 0, 1, 0], 4),
        ([], [], 0),
    ],
)
def test_what_overlaps_counts_once(spans, shares, length):
    covered = Spans()
    assert [covered.add(*span) for span in spans] == pytest.approx(shares)
    assert covered.length == pytest.approx(length)
