"""Wrong fixes are detected from the whole track, even if a quarter of them is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from tests.missions.core.simulated import Drive, rmse
from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.outliers import find_outliers
from webapp.missions.core.trajectory.smoother import smooth

GOOD = Noise(
    forward=0.02, sideways=0.01, heading=0.002, turning=0.01, scale=0.01, turn_scale=0.01, curve=3e-4
)


def spoiled(drive: Drive, *, share: float) -> np.ndarray:
    """Move some of the fixes elsewhere; return which, (m,) bool."""
    rng = np.random.default_rng(drive.seed + 1000)
    wrong = np.zeros(len(drive.node), dtype=bool)
    wrong[rng.permutation(len(wrong))[: round(share * len(wrong))]] = True
    angle = rng.uniform(-np.pi, np.pi, int(wrong.sum()))
    away = rng.uniform(20.0, 120.0, int(wrong.sum()))
    drive.measured[wrong] += away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return wrong


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_quarter_of_the_fixes_is_wrong(seed):
    drive = Drive(seed, nodes=800, every=20, noise=GOOD)
    wrong = spoiled(drive, share=0.25)
    judged = find_outliers(drive.steps, drive.fixes, noise=Noise())
    assert judged is not None
    assert (judged.weight == 0.0).tolist() == wrong.tolist()
    assert judged.begins_s == (0.0,)
    found = smooth(drive.steps, drive.fixes, noise=GOOD, judged=judged)
    assert rmse(found.state[:, :2], drive.truth) < 2.5
    off = np.hypot(*(drive.measured - found.expected).T)
    assert (off[wrong] > 15.0).all()


def test_good_fixes_are_all_used():
    drive = Drive(5, nodes=800, every=20, noise=GOOD)
    judged = find_outliers(drive.steps, drive.fixes, noise=Noise())
    assert (judged.weight == 1.0).all()


def test_who_was_carried_begins_a_new_piece():
    drive = Drive(6, nodes=800, every=20, noise=GOOD)
    later = drive.node >= 400
    drive.measured[later] += (300.0, -200.0)
    judged = find_outliers(drive.steps, drive.fixes, noise=Noise())
    assert (judged.weight == 1.0).all()
    assert judged.begins_s == (0.0, 200.0)


def test_without_odometry_the_speed_is_the_limit():
    drive = Drive(7, nodes=800, every=20, noise=GOOD)
    wrong = [5, 6, 20]
    drive.measured[wrong] += (400.0, -300.0)
    steps = replace(drive.steps, moves=np.full_like(drive.moves, np.nan))
    judged = find_outliers(steps, drive.fixes, noise=Noise())
    assert np.flatnonzero(judged.weight == 0.0).tolist() == wrong
    assert judged.begins_s == (0.0,)
