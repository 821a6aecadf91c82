"""The prior that cameras are held level."""

import numpy as np

from webapp.core.geometry import so3
from webapp.core.geometry.level_camera import LevelPrior, roll_pitch_sines


def test_tilts_are_zero_when_level_and_follow_small_turns():
    rotation = so3.from_heading(np.array([0.3, 2.0]))
    turn = np.array([[0.01, 0.0, -0.02], [0.005, 0.1, 0.0]])
    turned = so3.retract(rotation, turn)
    for (before, by_turn), (after, _) in zip(
        roll_pitch_sines(rotation), roll_pitch_sines(turned), strict=True
    ):
        np.testing.assert_allclose(before, 0.0, atol=1e-12)
        np.testing.assert_allclose(after, (by_turn * turn).sum(1), atol=2e-3)
        assert np.abs(after).max() > 1e-3


def test_the_prior_levels_a_camera_in_a_few_steps():
    rotation = so3.retract(so3.from_heading(np.array([0.3])), np.array([[0.1, 0.0, -0.08]]))
    for _ in range(4):
        matrix, vector = LevelPrior(0.03, 0.3).normal_equations(rotation)
        rotation = so3.retract(rotation, so3.solve_batched(matrix + 1e-6 * np.eye(3), vector))
    assert max(abs(sine[0]) for sine, _ in roll_pitch_sines(rotation)) < 1e-6


def test_roll_is_held_closer_than_pitch():
    level = so3.from_heading(np.array([0.0]))
    matrix, _ = LevelPrior(0.03, 0.3, weight=0.5).normal_equations(level)
    np.testing.assert_allclose(matrix[0, 2, 2], 0.5 / 0.03**2)  # about the line of sight
    np.testing.assert_allclose(matrix[0, 0, 0], 0.5 / 0.3**2)
