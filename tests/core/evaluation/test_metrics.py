import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.evaluation import metrics

INF = np.inf


def test_median_and_mean_leave_out_queries_without_a_hypothesis() -> None:
    errors = np.array([1.0, 2.0, 9.0, INF])
    assert metrics.median_error(errors) == 2.0
    assert metrics.mean_error(errors) == 4.0
    assert metrics.median_error(np.array([INF])) is None
    assert metrics.mean_error(np.array([INF])) is None


def test_share_within_counts_every_query_and_includes_the_edge() -> None:
    assert metrics.share_within(np.array([10.0, 10.001, 3.0, INF]), 10) == 0.5


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (0.0, "excellent"),
        (10.0, "excellent"),
        (10.1, "good"),
        (20.0, "good"),
        (20.1, "sufficient"),
        (40.0, "sufficient"),
        (40.1, "insufficient"),
        (INF, "insufficient"),
    ],
)
def test_grades_are_multiples_of_the_place_radius(error: float, word: str) -> None:
    assert metrics.grade(error, 20.0) == word


def test_calibration_error_by_hand() -> None:
    # two queries, so two bins with one query each: |0.2 - 0| and |0.9 - 1|
    assert metrics.expected_calibration_error([0.2, 0.9], [False, True]) == pytest.approx(0.15)


def test_calibration_error_has_ten_bins_of_equal_mass() -> None:
    probabilities = np.linspace(0.05, 1.0, 20)
    bins = metrics.reliability_bins(probabilities, np.ones(20))
    assert [b.count for b in bins] == [2] * 10
    assert bins[0].probability == pytest.approx(0.075)
    assert metrics.expected_calibration_error(probabilities, np.ones(20)) == pytest.approx(1 - 0.525)


def test_calibration_error_of_calibrated_answers_is_small_and_of_boasting_ones_is_not() -> None:
    rng = np.random.default_rng(1)
    probabilities = rng.uniform(size=20_000)
    right = rng.uniform(size=20_000) < probabilities
    calibrated = metrics.expected_calibration_error(probabilities, right)
    boasting = metrics.expected_calibration_error(np.sqrt(probabilities), right)
    assert calibrated is not None and calibrated < 0.015
    assert boasting is not None and boasting > 0.1


@given(
    st.lists(st.tuples(st.sampled_from([0.1, 0.4, 0.8]), st.booleans()), min_size=1, max_size=60),
    st.randoms(),
)
def test_calibration_error_does_not_depend_on_the_order(pairs: list[tuple[float, bool]], random) -> None:
    shuffled = list(pairs)
    random.shuffle(shuffled)
    first = metrics.expected_calibration_error(*zip(*pairs, strict=True))
    again = metrics.expected_calibration_error(*zip(*shuffled, strict=True))
    assert first == pytest.approx(again)


def test_calibration_error_of_nothing_is_unknown() -> None:
    assert metrics.expected_calibration_error([], []) is None
    assert metrics.reliability_bins([], []) == ()


def test_radius_coverage_looks_at_right_hypotheses_with_a_radius() -> None:
    errors = [1.0, 5.0, 8.0, 100.0, 2.0]
    radii = [2.0, 4.0, 9.0, 500.0, np.nan]
    assert metrics.radius_coverage(errors, radii, place_radius_px=20) == pytest.approx(2 / 3)
    assert metrics.radius_coverage([100.0], [5.0], place_radius_px=20) is None


def test_answered_at_precision_by_hand() -> None:
    probabilities = [0.9, 0.8, 0.7, 0.6]
    assert metrics.answered_at_precision(probabilities, [1, 1, 0, 1], queries=5) == pytest.approx(2 / 5)
    assert metrics.answered_at_precision(probabilities, [1, 1, 0, 1], queries=5, precision=0.75) == 0.8
    assert metrics.answered_at_precision(probabilities, [0, 1, 1, 1], queries=4) == 0.0
    assert metrics.answered_at_precision([], [], queries=3) == 0.0


def test_one_threshold_cannot_part_equal_probabilities() -> None:
    assert metrics.answered_at_precision([0.9, 0.9, 0.5], [True, False, True], queries=3) == 0.0


def test_99_of_100_is_99_percent() -> None:
    right = np.ones(100)
    right[50] = 0
    assert metrics.answered_at_precision(np.linspace(1, 0.1, 100), right, queries=100) == 1.0


def test_error_curve_ends_below_one_when_hypotheses_are_missing() -> None:
    values, shares = metrics.error_curve(np.array([3.0, 1.0, 3.0, INF]))
    assert values.tolist() == [1.0, 3.0]
    assert shares.tolist() == [0.25, 0.75]


def test_bootstrap_interval_of_a_share_is_the_binomial_one() -> None:
    hit = np.repeat([1.0, 0.0], [80, 20])
    interval = metrics.bootstrap_interval(lambda i: float(hit[i].mean()), 100, rng=np.random.default_rng(3))
    assert interval is not None
    low, high = interval
    assert low == pytest.approx(0.8 - 1.96 * 0.04, abs=0.015)
    assert high == pytest.approx(0.8 + 1.96 * 0.04, abs=0.015)


def test_bootstrap_repeats_with_the_same_generator_and_knows_when_there_is_nothing() -> None:
    values = np.arange(30.0)
    runs = [
        metrics.bootstrap_interval(lambda i: float(np.median(values[i])), 30, rng=np.random.default_rng(5))
        for _ in range(2)
    ]
    assert runs[0] == runs[1]
    assert metrics.bootstrap_interval(lambda i: None, 30, rng=np.random.default_rng(5)) is None
