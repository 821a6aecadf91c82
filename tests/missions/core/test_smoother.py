"""The smoother estimates its errors correctly, bridges gaps, and resists outliers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.missions.core.simulated import Drive, nees, rmse
from webapp.missions.core.trajectory.alignment import start
from webapp.missions.core.trajectory.motion import Noise, predict
from webapp.missions.core.trajectory.smoother import mean_distance_bounds, smooth
from webapp.missions.core.trajectory.steps import Fixes, Steps

RUNS = 60
POSITION_BOUNDS, HEADING_BOUNDS = (1.257, 2.960), (0.505, 1.713)
"""Bounds of 99.9 % for the mean of 60 chi-squared values with two and with one degree of freedom."""

finite = st.floats(-3, 3)


@pytest.fixture(scope="module")
def runs():
    """Drives with their smoothed tracks."""
    drives = [Drive(seed) for seed in range(RUNS)]
    return [(drive, smooth(drive.steps, drive.fixes)) for drive in drives]


def test_the_errors_are_as_large_as_it_says(runs):
    by_node = np.mean([nees(done, drive) for drive, done in runs], axis=0)[::20]
    assert by_node.min() > POSITION_BOUNDS[0]
    assert by_node.max() < POSITION_BOUNDS[1]
    assert 1.8 < by_node.mean() < 2.2


def test_the_heading_is_as_wrong_as_it_says(runs):
    off = np.array(
        [np.remainder(done.state[:, 4] - drive.heading + np.pi, 2 * np.pi) - np.pi for drive, done in runs]
    )
    spread = np.array([done.covariance[:, 4, 4] for _, done in runs])
    by_node = (off**2 / spread).mean(axis=0)[::20]
    assert by_node.min() > HEADING_BOUNDS[0]
    assert by_node.max() < HEADING_BOUNDS[1]
    assert 0.85 < by_node.mean() < 1.15


def test_innovations_follow_their_distribution(runs):
    # The first fixes determined the start.
    distance = np.concatenate([done.distance[8:][~done.gated[8:]] for _, done in runs])
    low, high = mean_distance_bounds(len(distance))
    assert low < distance.mean() < high
    assert sum(done.gated.sum() for _, done in runs) < 0.003 * len(distance)
    assert all(done.begins == (0,) for _, done in runs)


def test_it_is_better_than_the_fixes_and_than_reckoning(runs):
    fused = np.mean([rmse(done.state[:, :2], drive.truth) for drive, done in runs])
    assert fused < 0.4 * np.mean([rmse(drive.measured, drive.truth[drive.node]) for drive, _ in runs])
    assert fused < 0.2 * np.mean([rmse(drive.reckoned(), drive.truth) for drive, _ in runs])


def test_systematic_errors_of_the_odometry_are_found():
    drive = Drive(3, nodes=800, sigma_m=0.3)
    drive.moves[:, 0] *= 0.9  # wheel radius calibrated wrongly
    state = smooth(drive.steps, drive.fixes).state
    true_way = np.hypot(*np.diff(drive.truth, axis=0).T).sum()
    assert 1 + state[-1, 5] == pytest.approx(true_way / drive.moves[1:, 0].sum(), rel=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_outliers_are_left_out_and_nothing_else(seed):
    drive = Drive(seed)
    wrong = drive.rng.choice(len(drive.node), len(drive.node) // 8, replace=False)
    angle = drive.rng.uniform(0, 2 * np.pi, len(wrong))
    drive.measured[wrong] += drive.rng.uniform(20, 100, (len(wrong), 1)) * np.column_stack(
        [np.sin(angle), np.cos(angle)]
    )
    done = smooth(drive.steps, drive.fixes)
    assert set(wrong) <= set(np.flatnonzero(done.gated))
    assert done.gated.sum() <= len(wrong) + 1
    assert rmse(done.state[:, :2], drive.truth) < 1.5


def test_a_first_fix_that_is_wrong_spoils_nothing():
    drive = Drive(1)
    drive.measured[0] += 80
    done = smooth(drive.steps, drive.fixes)
    assert np.flatnonzero(done.gated).tolist() == [0]
    assert np.hypot(*(done.state[0, :2] - drive.truth[0])) < 4


def test_a_gap_is_bridged_by_odometry():
    fused, reckoned, inside = [], [], []
    for seed in range(30):
        drive = Drive(seed)
        keep = (drive.node < 90) | (drive.node > 180)
        done = smooth(drive.steps, drive.fixes.take(keep))
        inside.append(nees(done, drive)[135])
        fused.append(rmse(done.state[100:170, :2], drive.truth[100:170]))
        reckoned.append(rmse(drive.reckoned()[100:170], drive.truth[100:170]))
    assert 1.35 < np.mean(inside) < 2.78  # 95 % of the mean of 30
    assert np.median(fused) < 2
    assert np.mean(fused) < 0.5 * np.mean(reckoned)


def test_who_was_carried_away_is_found_again():
    drive = Drive(2, nodes=400)
    drive.truth[200:] += (150, -80)
    drive.measured[drive.node >= 200] += (150, -80)
    done = smooth(drive.steps, drive.fixes)
    assert done.begins == (0, 200)
    assert not done.gated.any()
    assert rmse(done.state[:, :2], drive.truth) < 1.5


def test_a_few_fixes_that_are_wrong_alike_are_no_reason_to_move():
    drive = Drive(4)
    drive.measured[20:24] += (40, 0)
    done = smooth(drive.steps, drive.fixes)
    assert np.flatnonzero(done.gated).tolist() == [20, 21, 22, 23]
    assert done.begins == (0,)


def test_many_fixes_in_a_moment_are_no_reason_to_move():
    drive = Drive(4, seconds=0.1, every=1)
    drive.measured[100:150] += (40, 0)  # five seconds of reflections
    done = smooth(drive.steps, drive.fixes)
    assert done.gated[100:150].all()
    assert done.begins == (0,)


def without_odometry(drive):
    """Smooth the drive from its fixes alone."""
    nothing = np.full_like(drive.moves, np.nan)
    return Steps(drive.steps.times_s, nothing, np.full(drive.nodes, np.nan))


def test_without_odometry_it_smooths():
    better = []
    for seed in range(10):
        drive = Drive(seed, every=2)
        drive.measured[30] += 60
        done = smooth(without_odometry(drive), drive.fixes)
        assert np.flatnonzero(done.gated).tolist() == [30]
        better.append(rmse(done.state[:, :2], drive.truth) / drive.sigma_m)
    assert np.mean(better) < 1.1  # of 1.41 for the fixes


def test_odometry_that_begins_late_and_ends_early():
    drive = Drive(6)
    steps = drive.steps
    steps.moves[:60] = steps.moves[200:] = np.nan
    done = smooth(steps, drive.fixes)
    assert not done.gated.any()
    assert rmse(done.state[:, :2], drive.truth) < 2.0


def test_a_linear_track_is_the_least_squares_solution():
    """Without odometry the problem is linear: the smoother must equal the solution of one large system."""
    rng, n, noise = np.random.default_rng(5), 12, Noise()
    times = np.cumsum(rng.uniform(0.5, 4, n))
    steps = Steps(times, np.full((n, 3), np.nan), np.full(n, np.nan))
    fixes = Fixes(np.arange(n), rng.normal(0, 2, (n, 2)), np.tile(np.eye(2) * 9.0, (n, 1, 1)), np.ones(n))
    done = smooth(steps, fixes)
    precision, right = np.zeros((4 * n, 4 * n)), np.zeros(4 * n)
    for i in range(n):
        place = slice(4 * i, 4 * i + 2)
        precision[place, place] += np.eye(2) / 9
        right[place] += fixes.position[i] / 9
    for i in range(1, n):
        _, change, added = predict(
            np.zeros(8), np.full(3, np.nan), seconds=times[i] - times[i - 1], noise=noise
        )
        rows = np.hstack([-change[:4, :4], np.eye(4)])
        both = slice(4 * i - 4, 4 * i + 4)
        precision[both, both] += rows.T @ np.linalg.inv(added[:4, :4]) @ rows
    begun = start(steps, fixes, begin=0, noise=noise)
    prior = np.linalg.inv(begun.covariance[:4, :4])
    precision[:4, :4] += prior

    right[:4] += prior @ begun.state[:4]
    assert done.state[:, :4] == pytest.approx(np.linalg.solve(precision, right).reshape(n, 4), abs=1e-6)
    spread = np.linalg.inv(precision)
    for i in range(n):
        block = slice(4 * i, 4 * i + 4)
        assert done.covariance[i, :4, :4] == pytest.approx(spread[block, block], abs=1e-6)


@given(st.tuples(finite, finite, finite, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)),
       st.tuples(finite, finite, finite), st.floats(0.05, 5))  # fmt: skip
def test_the_derivative_is_that_of_the_movement(values, move, seconds):
    state = np.array([*values[:2], 0.0, 0.0, *values[2:]])
    moved = np.array(move)

    def after(at):
        return predict(at, moved, seconds=seconds, noise=Noise())[0]

    _, change, added = predict(state, moved, seconds=seconds, noise=Noise())
    step = 1e-6
    numeric = np.column_stack(
        [(after(state + step * e) - after(state - step * e)) / (2 * step) for e in np.eye(8)]
    )
    assert change == pytest.approx(numeric, abs=1e-4)
    assert np.linalg.eigvalsh(added).min() >= -1e-12


def test_the_progress_callback_can_stop_it():
    drive = Drive(0, nodes=2500)

    def stop(node):
        if node:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        smooth(drive.steps, drive.fixes, check=stop)
