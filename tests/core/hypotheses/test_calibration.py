import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.hypotheses import calibration
from webapp.core.hypotheses.calibration import DEFAULT, EVIDENCE, Calibration, Case, fit, probabilities

FLOATS = st.floats(-30, 30, allow_nan=False)


@given(st.lists(st.tuples(*[FLOATS] * EVIDENCE), max_size=8))
def test_places_and_off_map_add_up_to_one(rows):
    place, off_map = probabilities(np.array(rows, float).reshape(-1, EVIDENCE), DEFAULT)
    assert place.sum() + off_map == pytest.approx(1.0, abs=1e-12)
    assert (place >= 0).all() and 0 <= off_map <= 1


def test_no_place_is_off_the_map():
    place, off_map = probabilities(np.zeros((0, EVIDENCE)), DEFAULT)
    assert len(place) == 0 and off_map == 1.0


def test_more_evidence_is_more_probable():
    weak, _ = probabilities(np.array([[0.0, 0.2, 0.1, 0.3, 0.3]]), DEFAULT)
    strong, _ = probabilities(np.array([[4.0, 0.8, 1.0, 2.0, 1.0]]), DEFAULT)
    assert weak[0] < 0.5 < 0.9 < strong[0]


@pytest.mark.parametrize("score", [0.0, -2.0])
def test_places_without_evidence_have_no_mass_however_many_they_are(score):
    evidence = np.zeros((30, EVIDENCE))
    evidence[:, 1] = score
    place, off_map = probabilities(evidence, DEFAULT)
    assert off_map > 0.75
    evidence[0] = 4.0, 0.8, 1.0, 2.0, 1.0, 0.0
    place, _ = probabilities(evidence, DEFAULT)
    assert place[0] > 0.9


def test_less_evidence_than_by_chance_keeps_its_order():
    weight = np.array([-6.0, -5.0, -1.0, 0.0, 0.1, 3.0, 30.0])
    odds = calibration.log_odds(weight)
    assert (np.diff(odds) > 0).all()
    assert odds[-1] == pytest.approx(30.0) and odds[3] < -1.5
    slope = (calibration.log_odds(weight + 1e-6) - odds) / 1e-6
    assert calibration._log_odds_slope(weight) == pytest.approx(slope, rel=1e-4)


def simulated(rng, count, truth):
    """Draw cases from a known model: two places and off-map."""
    cases = []
    for _ in range(count):
        evidence = np.column_stack(
            [
                np.full(2, rng.uniform(0, 5)),
                np.full(2, 0.5),
                [0.3, rng.uniform(-1, 0)],
                [0.0, rng.uniform(-1, 0)],
                np.full(2, rng.uniform(0, 2)),
            ]
        )
        place, off_map = probabilities(evidence, truth)
        drawn = rng.choice(3, p=[*place, off_map])
        cases.append(Case(evidence, np.arange(2) == drawn))
    return cases


def test_fit_finds_the_model_that_made_the_cases(monkeypatch):
    monkeypatch.setattr(calibration, "_PRIOR_WEIGHT", 0.01)
    truth = Calibration(slope=(1.6, 2.0, 1.0, 5.0, 0.5), offset=-5.0, radius_scale=1.0)
    rng = np.random.default_rng(0)
    slope, offset = fit(simulated(rng, 4000, truth))
    fitted = Calibration(slope, offset, 1.0)
    test = simulated(rng, 2000, truth)
    stated = np.array([probabilities(c.evidence, fitted)[0][0] for c in test])
    happened = np.array([c.right[0] for c in test])
    for part in np.array_split(np.argsort(stated), 5):
        assert stated[part].mean() == pytest.approx(happened[part].mean(), abs=0.06)


def test_few_cases_change_the_default_little_and_none_not_at_all():
    assert fit([]) == (DEFAULT.slope, DEFAULT.offset)
    one = [Case(np.array([[0.0, 0.1, 0.0, 0.0, 0.0]]), np.array([True]))]
    slope, offset = fit(one)
    assert abs(offset - DEFAULT.offset) < 1.0
    assert np.abs(np.array(slope) - DEFAULT.slope).max() < 1.0


def test_slopes_are_never_negative():
    perverse = [Case(np.array([[5.0, 1.0, 0.0, 0.0, 1.0]]), np.array([False]))] * 300
    perverse += [Case(np.array([[0.0, 0.0, 0.0, 0.0, 0.0]]), np.array([True]))] * 300
    slope, _ = fit(perverse)
    assert min(slope) >= 0.0


def penalised_loss(cases, slope, offset):
    """Return the loss that a fit minimises, computed from the resulting probabilities."""
    fitted = Calibration(slope, offset, 1.0)
    away = [*np.subtract(slope, DEFAULT.slope), offset - DEFAULT.offset]
    loss = calibration._PRIOR_WEIGHT * len(cases) ** 0.5 * float(np.square(away).sum()) / 2.0
    for case in cases:
        place, off_map = probabilities(case.evidence, fitted)
        loss -= np.log(place[case.right].sum() if case.right.any() else off_map)
    return loss


@pytest.mark.parametrize("seed", range(3))
def test_fit_reaches_the_least_loss_also_where_evidence_misleads(seed):
    rng = np.random.default_rng(seed)
    cases = []
    for _ in range(300):
        evidence = rng.uniform(0.0, 3.0, (3, EVIDENCE))
        right = np.arange(3) == evidence[:, 0].argmax()
        evidence[:, 1] = 3.0 - evidence[:, 0] + rng.normal(0.0, 0.1, 3)
        evidence[:, 2] = evidence[:, 1] * evidence[:, 3]
        cases.append(Case(evidence, right & (rng.random() < 0.8)))
    slope, offset = fit(cases)
    least = penalised_loss(cases, slope, offset)
    assert min(slope) == 0.0
    for _ in range(200):
        near = np.maximum(np.add(slope, rng.normal(0.0, 0.05, EVIDENCE)), 0.0)
        assert penalised_loss(cases, tuple(near), offset + rng.normal(0.0, 0.05)) >= least


def with_global(case, similarity):
    """Return the case with evidence of a global descriptor for each place added."""
    return Case(np.column_stack([case.evidence, similarity]), case.right, case.weight)


@pytest.fixture
def cases():
    truth = Calibration(slope=(1.6, 2.0, 1.0, 5.0, 0.5), offset=-5.0, radius_scale=1.0)
    return simulated(np.random.default_rng(3), 60, truth)


def test_without_a_global_descriptor_nothing_changes_to_the_last_bit(cases):
    before = Calibration(DEFAULT.slope[:5], DEFAULT.offset, 1.0)
    slope, offset = fit(cases, start=before)
    now = [with_global(case, np.zeros(2)) for case in cases]
    assert fit(now) == ((*slope, DEFAULT.slope[5]), offset)
    fitted = Calibration((*slope, 0.7), offset, 1.0)
    for old, new in zip(cases, now, strict=True):
        one, other = probabilities(old.evidence, Calibration(slope, offset, 1.0))
        same, as_much = probabilities(new.evidence, fitted)
        assert (one == same).all() and other == as_much


@pytest.mark.parametrize("right", [True, False])
def test_what_a_global_descriptor_is_worth_is_fitted_and_never_negative(cases, right):
    told = [with_global(c, 2.0 * (c.right if right else ~c.right)) for c in cases]
    assert DEFAULT.slope[5] == 0.0
    slope, _ = fit(told)
    assert slope[5] > 0.5 if right else slope[5] == 0.0
