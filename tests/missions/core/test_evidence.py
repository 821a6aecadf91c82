"""The evidence of assumptions about fixes: exact formulas, and what they find."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.missions.core.simulated import Drive
from webapp.missions.core.trajectory import evidence
from webapp.missions.core.trajectory.evidence import (
    Factors,
    FixModel,
    Labels,
    Run,
    distances,
    linearised,
    log_evidence,
    refine,
    search,
)
from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.smoother import smooth

AREA_M2 = math.pi * 100.0**2


def modelled(drive: Drive, *, about=None, source="gps") -> FixModel:
    """Return the fixes of a drive about a track, by default the smoothed one."""
    steps, fixes = drive.steps, drive.fixes
    state = smooth(steps, fixes, noise=drive.noise).state if about is None else about
    residual, start, motion = linearised(
        steps, fixes, state=state, piece=range(drive.nodes), noise=drive.noise
    )
    m = len(fixes)
    return FixModel(
        residual,
        start,
        motion,
        np.linalg.cholesky(fixes.covariance),
        steps.times_s[fixes.node],
        np.zeros(m, dtype=np.intp),
        (0,),
        np.full(m, source),
        True,
        AREA_M2,
    )


def right(model: FixModel) -> Labels:
    return Labels(np.zeros(len(model), dtype=bool))


def factors(stated=1.0, motion=1.0, correlated_s=0.0) -> Factors:
    return Factors(motion, (stated,), (correlated_s,))


@pytest.fixture(scope="module")
def short() -> FixModel:
    """A short drive of 15 fixes."""
    return modelled(Drive(3, nodes=150, every=10))


def normal(model: FixModel, covariance) -> float:
    r = model.residual
    distance = r @ np.linalg.solve(covariance, r)
    return float(-(distance + np.linalg.slogdet(covariance)[1] + len(r) * math.log(2 * math.pi)) / 2)


def test_without_assumptions_it_is_the_density_of_the_residuals(short):
    labels = right(short)
    covariance = short.start + short.motion * 4.0 + np.eye(30) * 4.0 * 9.0
    expected = normal(short, covariance) + labels.log_prior()
    expected -= (1.0**2 + math.log2(3.0) ** 2) / evidence.FACTOR_SPREAD**2 / 2
    assert log_evidence(short, labels, factors=factors(3.0, motion=2.0)) == pytest.approx(expected)


@pytest.mark.parametrize("growing", [False, True])
def test_a_uniform_shift_is_one_of_very_wide_distribution(short, growing):
    """The limit of normal priors whose density at 0 is that of the uniform one."""
    members, wide = np.arange(4, 9), 1e4
    labels = Labels(right(short).wrong, (Run(members, growing, False, -3.0),))
    column = np.zeros((15, 2, 2))
    column[members] = (np.linspace(0.2, 1, 5) if growing else np.ones(5))[:, None, None] * np.eye(2)
    both = column.reshape(30, 2)
    covariance = short.covariance(factors()) + wide**2 * both @ both.T
    expected = normal(short, covariance) + math.log(2 * math.pi * wide**2 / AREA_M2)
    assert log_evidence(short, labels, factors=factors()) == pytest.approx(
        expected + labels.log_prior(), abs=1e-3
    )


def test_a_wrong_fix_is_a_shift_of_its_own(short):
    wrong = right(short).wrong.copy()
    wrong[6] = True
    alone = Labels(right(short).wrong, (Run(np.array([6]), False, False, 0.0),))
    without_prior = [
        log_evidence(short, one, factors=factors()) - one.log_prior() for one in (Labels(wrong), alone)
    ]
    assert without_prior[0] == pytest.approx(without_prior[1])


def test_what_a_change_would_gain_is_known_before(short):
    """By the formulas for a single change, from one solution."""
    wrong = right(short).wrong.copy()
    wrong[[2, 7]] = True
    labels = Labels(wrong, (Run(np.arange(9, 13), False, False, -3.0),))
    covariance = short.covariance(factors())
    solved = evidence._solve(short, labels, covariance)
    known = evidence._inverse(short, solved)
    gain = evidence._of_fixes(short, labels, solved, covariance=covariance, known=known)
    before = log_evidence(short, labels, factors=factors())
    for at in range(15):
        after = log_evidence(short, evidence._with(labels, wrong=at), factors=factors())
        assert gain[at] == pytest.approx(after - before, abs=1e-6)


@pytest.mark.parametrize("growing", [False, True])
def test_the_best_run_is_found_and_gains_what_it_promises(growing):
    drive = Drive(3, nodes=600, every=10)
    drive.measured[20:32] += np.outer(3.0 * np.arange(1, 13) if growing else np.full(12, 8.0), (1.0, -1.0))
    model = modelled(drive, about=smooth(drive.steps, Drive(3, nodes=600, every=10).fixes).state)
    labels, covariance = right(model), model.covariance(factors())
    solved = evidence._solve(model, labels, covariance)
    run, gain = evidence._best_run(model, labels, evidence._inverse(model, solved))
    assert run.members.tolist() == pytest.approx(list(range(20, 32)), abs=1)
    assert (run.growing, run.carried) == (growing, False)
    after = log_evidence(model, replace(labels, runs=(run,)), factors=factors())
    assert gain == pytest.approx(after - log_evidence(model, labels, factors=factors()), abs=1e-6)


def test_prediction_errors_are_as_large_as_assumed():
    mean = [
        distances(one, right(one), factors=factors()).mean()
        for one in (modelled(Drive(s)) for s in range(30))
    ]
    assert np.mean(mean) == pytest.approx(2.0, abs=0.1)


def test_noise_is_found_for_odometry_and_source():
    """Half of the usual errors of odometry, three times those stated."""
    found = []
    for seed in range(6):
        drive = Drive(seed, nodes=800, every=8, sigma_m=3.0)
        model = modelled(drive)
        stated = replace(model, root=model.root / 3.0, motion=model.motion * 4.0)
        found.append(refine(stated, right(model), factors=factors())[0])
    assert np.median([one.stated[0] for one in found]) == pytest.approx(3.0, rel=0.2)
    assert np.median([one.motion for one in found]) == pytest.approx(0.5, rel=0.35)
    assert all(one.correlated_s == (0.0,) for one in found)


def test_correlated_errors_are_noticed():
    drive = Drive(5, nodes=600, every=2)
    rng, kept, off = np.random.default_rng(5), math.exp(-1.0 / 20.0), np.zeros((300, 2))
    for i in range(300):
        off[i] = kept * off[i - 1] + rng.normal(0, 2.0 * (1 - kept**2) ** 0.5, 2)
    drive.measured = drive.truth[drive.node] + off
    model = modelled(drive)
    assert refine(model, right(model), factors=factors())[0].correlated_s == (20.0,)


def test_wrong_fixes_are_found_one_after_the_other_and_taken_back():
    drive = Drive(4, nodes=400, every=10, noise=Noise(heading=0.003, curve=0.001, turn_scale=0.01))
    wrong = [3, 11, 12, 30]
    state = smooth(drive.steps, drive.fixes, noise=drive.noise).state
    drive.measured[wrong] += [(25.0, 10.0), (30.0, 0.0), (-10.0, 30.0), (-25.0, 0.0)]
    model = modelled(drive, about=state)
    begun = np.zeros(len(model), dtype=bool)
    begun[5:20] = True
    for labels in (right(model), Labels(begun)):
        found, value = search(model, labels, factors=factors())
        assert np.flatnonzero(found.wrong).tolist() == wrong
        assert not found.runs
        assert value == pytest.approx(log_evidence(model, found, factors=factors()))


def test_wrong_fixes_that_agree_are_shifted_together():
    drive = Drive(4, nodes=400, every=10)
    state = smooth(drive.steps, drive.fixes, noise=drive.noise).state
    drive.measured[11:14] += (25.0, 10.0)
    model = modelled(drive, about=state)
    begun = np.zeros(len(model), dtype=bool)
    begun[8:20] = True
    for labels in (right(model), Labels(begun)):
        found, _ = search(model, labels, factors=factors())
        assert not found.wrong.any()
        assert [run.members.tolist() for run in found.runs] == [[11, 12, 13]]
