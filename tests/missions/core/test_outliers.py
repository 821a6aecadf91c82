"""Wrong fixes are detected from the whole track, even if a quarter of them is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from tests.missions.core.simulated import Drive, rmse
from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.outliers import explain
from webapp.missions.core.trajectory.smoother import OutlierLabels, smooth

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


def explained(drive: Drive, *, steps=None):
    """Explain the fixes of a drive."""
    source = np.full(len(drive.node), "gps")
    return explain(steps or drive.steps, drive.fixes, source=source, usual=Noise())


@pytest.mark.parametrize(("seed", "share"), [(1, 0.25), (2, 0.25), (3, 0.4)])
def test_a_quarter_of_the_fixes_is_wrong_or_more(seed, share):
    drive = Drive(seed, nodes=800, every=20, noise=GOOD)
    wrong = spoiled(drive, share=share)
    found = explained(drive)
    assert (found.weight == 0.0).tolist() == wrong.tolist()
    assert found.begins_s == (0.0,)
    assert found.factors.stated[0] < 1.5
    judged = OutlierLabels(found.weight, found.begins_s)
    track = smooth(drive.steps, drive.fixes, noise=GOOD, judged=judged)
    assert rmse(track.state[:, :2], drive.truth) < 2.5
    off = np.hypot(*(drive.measured - track.expected).T)
    assert (off[wrong] > 15.0).all()


def test_good_fixes_are_all_used():
    drive = Drive(5, nodes=800, every=20, noise=GOOD)
    found = explained(drive)
    assert (found.weight == 1.0).all()
    assert found.factors.motion < 0.6  # the noise is a fifth to a half of the usual one
    assert not found.shifted


@pytest.mark.parametrize("turned", [0.0, 1.2])
def test_who_was_carried_begins_a_new_piece(turned):
    drive = Drive(6, nodes=800, every=20, noise=GOOD)
    later = drive.node >= 400
    about = drive.truth[400]
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    drive.measured[later] = (drive.measured[later] - about) @ turn.T + about + (300.0, -200.0)
    found = explained(drive)
    assert (found.weight == 1.0).all()
    assert found.begins_s == (0.0, 200.0)


def test_a_receiver_that_is_shifted_for_a_minute_and_returns_was_not_carried():
    drive = Drive(6, nodes=800, every=10, noise=GOOD)
    during = slice(40, 52)
    drive.measured[during] += (14.0, -8.0)
    found = explained(drive)
    assert [run.tolist() for run in found.shifted] == [list(range(40, 52))]
    assert np.flatnonzero(found.weight == 0.0).tolist() == list(range(40, 52))
    assert found.begins_s == (0.0,)


def test_a_wrong_start_is_no_piece():
    drive = Drive(8, nodes=800, every=10, noise=GOOD)
    drive.measured[:6] += (-30.0, 25.0)
    found = explained(drive)
    assert np.flatnonzero(found.weight == 0.0).tolist() == list(range(6))
    assert found.begins_s == (0.0,)


def test_without_odometry_the_speed_is_the_limit():
    drive = Drive(7, nodes=800, every=20, noise=GOOD)
    wrong = [5, 6, 20]
    drive.measured[wrong] += (400.0, -300.0)
    steps = replace(drive.steps, moves=np.full_like(drive.moves, np.nan))
    found = explained(drive, steps=steps)
    assert np.flatnonzero(found.weight == 0.0).tolist() == wrong
    assert found.begins_s == (0.0,)
