"""The benchmark of landmarks: cameras in a scene with ground truth."""

import pytest

from benchmarks.landmarks import measure

pytestmark = pytest.mark.slow


def test_cameras_are_within_a_decimetre_and_a_fifth_of_a_degree():
    found = measure(4000, photos=60, queries=8)
    assert found["solved"] == 8
    assert found["median_m"] <= 0.1
    assert found["median_deg"] <= 0.2
    assert found["worst_m"] <= 0.5
