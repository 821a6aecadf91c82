"""Simulations of placing: the vertical of pitched cameras, and wrong clicks."""

import pytest

from benchmarks import placing_simulations

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def few_runs(monkeypatch):
    monkeypatch.setattr(placing_simulations, "RUNS", 4)


@pytest.mark.parametrize("pitch_deg", [0.0, -45.0, -90.0])
def test_cameras_of_any_pitch_are_placed_by_six_clicks(pitch_deg):
    found = placing_simulations.at_pitch(pitch_deg)
    assert found["median_m"] < 0.3
    assert found["heading_off_deg"] < 2.0
    assert found["median_m_by_level_cameras"] > 2.0 or pitch_deg == 0.0


@pytest.mark.parametrize("clicks", [4, 12])
def test_a_wrong_click_is_named_and_the_others_are_not(clicks):
    found = placing_simulations.with_wrong_click(clicks)
    assert found["named"] == 4
    assert found["another_named"] == found["named_of_right_ones"] == 0
    assert found["median_m"] < 1.0
