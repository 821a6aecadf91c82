"""The belief about a sequence on simulated walks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import fit_path_prior
from webapp.core.hypotheses.sequence import (
    Belief,
    belief_from_json,
    belief_to_json,
    filter_step,
    motion_model,
    smooth,
)

COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)
RADIUS = 20.0
ROW = np.column_stack([np.arange(0.0, 2000.0, 10.0), np.full(200, 100.0)])
MOTION = motion_model(fit_path_prior(ROW, place_radius_px=RADIUS))


def place(x, y=100.0, *, p=0.9, radius=8.0, photos=(1,)):
    return Hypothesis(1, "position", MapPixel(x, y), p, radius, 90.0, photos, 30, 40)


def answer(*places):
    return Answer(tuple(places), 1.0 - sum(h.probability for h in places), 0.0, None, COUNTS)


def nothing():
    return Answer((), 1.0, 0.0, NoPose("no keypoints"), COUNTS)


def walk(frames, motion=MOTION, belief=None):
    belief, answers = belief or Belief(), []
    for frame in frames:
        belief, joined = filter_step(belief, frame, motion=motion, top=5)
        answers.append(joined)
    return belief, answers


def simulated(truth, rng, *, right=0.85, noise=8.0, radius=10.0):
    """Return answers that are right with their stated probability, and otherwise anywhere on the row."""
    frames = []
    for at in truth:
        x, y = at + rng.normal(0.0, noise, 2) if rng.random() < right else (rng.uniform(0, 2000), 100.0)
        frames.append(answer(place(float(x), float(y), p=right, radius=radius)))
    return frames


def errors(answers, truth):
    return np.array(
        [
            math.dist(a.hypotheses[0].position, t) if a.hypotheses else np.inf
            for a, t in zip(answers, truth, strict=True)
        ]
    )


def line(first, count, step=10.0):
    return [np.array([first + step * i, 100.0]) for i in range(count)]


def test_a_walk_is_followed_better_than_frame_by_frame():
    rng = np.random.default_rng(1)
    truth = line(100, 150)
    frames = simulated(truth, rng)
    joined = errors(walk(frames)[1], truth)
    alone = errors(frames, truth)
    assert np.mean(alone <= RADIUS) < 0.9
    assert np.mean(joined[3:] <= RADIUS) >= 0.98
    assert np.median(joined) < np.median(alone)


def test_an_odd_frame_does_not_move_the_belief():
    frames = [answer(place(100.0 + 10 * i)) for i in range(8)]
    belief, _ = walk(frames)
    _, (odd,) = walk([answer(place(1500.0, p=0.95))], belief=belief)
    assert abs(odd.hypotheses[0].position.x - 180.0) < RADIUS
    assert odd.hypotheses[0].heading_deg is None and odd.hypotheses[0].matches == 0


@pytest.mark.parametrize("p", [0.6, 0.9])
def test_who_was_carried_elsewhere_is_found_within_a_few_frames(p):
    before = [answer(place(100.0 + 10 * i, p=p)) for i in range(20)]
    after = [answer(place(1500.0 + 10 * i, p=p)) for i in range(8)]
    _, answers = walk(before + after)
    off = errors(answers[20:], line(1500, 8))
    assert (off <= RADIUS).argmax() <= 5
    assert (off[6:] <= RADIUS).all()


def test_later_frames_help_too():
    rng = np.random.default_rng(9)
    truth = line(100, 100)
    frames = simulated(truth, rng, right=0.7)
    filtered, smoothed = walk(frames)[1], smooth(frames, motion=MOTION, top=5)
    assert errors(smoothed, truth).max() <= RADIUS < errors(filtered, truth).max()
    assert np.median(errors(smoothed, truth)) < np.median(errors(filtered, truth))
    for joined in smoothed:
        parts = sum(h.probability for h in joined.hypotheses) + joined.other_probability
        assert parts + joined.off_map_probability == pytest.approx(1.0)


def test_who_was_carried_elsewhere_is_known_to_be_there_at_once_when_all_frames_are_there():
    before = [answer(place(100.0 + 10 * i)) for i in range(20)]
    after = [answer(place(1500.0 + 10 * i)) for i in range(20)]
    smoothed = smooth(before + after, motion=MOTION, top=5)
    assert errors(smoothed, [*line(100, 20), *line(1500, 20)]).max() <= RADIUS


def test_a_sequence_of_one_frame_or_of_dark_ones_is_no_more():
    frame = answer(place(500.0, p=0.6))
    assert smooth([frame], motion=MOTION, top=5) == walk([frame])[1]
    assert all(a.abstained for a in smooth([nothing()] * 3, motion=MOTION, top=5))
    assert smooth([], motion=MOTION, top=5) == []


def test_corners_are_taken():
    grid = np.array([(x, y) for x in range(0, 600, 20) for y in range(0, 600, 20)], float)
    along = [np.array([50.0 + 20 * i, 300.0]) for i in range(15)]
    truth = along + [along[-1] + (0.0, 20.0 * i) for i in range(1, 11)]
    rng = np.random.default_rng(3)
    frames = [answer(place(*(at + rng.normal(0, 6, 2)))) for at in truth]
    _, answers = walk(frames, motion_model(fit_path_prior(grid, place_radius_px=40.0)))
    assert errors(answers, truth).max() <= 40.0


def test_the_first_frame_is_as_sure_as_alone():
    frame = answer(place(500.0, p=0.6, radius=5.0), place(900.0, p=0.3, radius=5.0))
    _, (joined,) = walk([frame])
    assert joined.off_map_probability == pytest.approx(0.1, abs=1e-6)
    assert joined.hypotheses[0].probability <= 0.6
    assert joined.hypotheses[0].probability == pytest.approx(0.6, abs=0.1)


def test_what_is_off_the_map_stays_off_it():
    rng = np.random.default_rng(2)
    frames = [answer(place(float(rng.uniform(0, 2000)), p=0.05)) for _ in range(30)]
    _, answers = walk(frames)
    assert all(a.abstained for a in answers)


@pytest.mark.parametrize("step", [0.0, 10.0])
def test_frames_of_a_foreign_scene_that_agree_on_wrong_places_stay_as_uncertain_as_each(step):
    """Its frames resemble the same places repeatedly, or places along a course."""
    frames = [
        replace(
            answer(*(place(x + step * number, p=0.06) for x in (200.0, 900.0, 1500.0))),
            off_map_probability=0.45,
            other_probability=0.37,
        )
        for number in range(40)
    ]
    for answers, least in ((walk(frames)[1], 0.35), (smooth(frames, motion=MOTION, top=5), 0.25)):
        assert all(a.abstained for a in answers)
        assert min(a.off_map_probability for a in answers) > least
        assert max(a.hypotheses[0].probability for a in answers) < 0.2
    for number, frame in enumerate(frames):
        frames[number] = replace(frame, off_map_probability=0.7, other_probability=0.12)
    assert walk(frames)[1][-1].off_map_probability > 0.8


def test_leaving_the_map_is_noticed():
    rng = np.random.default_rng(2)
    frames = [answer(place(100.0 + 10 * i)) for i in range(10)]
    frames += [answer(place(float(rng.uniform(0, 2000)), p=0.03)) for _ in range(30)]
    _, answers = walk(frames)
    assert not answers[9].abstained and answers[-1].abstained


def test_dark_frames_say_nothing():
    belief, _ = walk([answer(place(100.0 + 10 * i)) for i in range(10)])
    _, answers = walk([nothing()] * 5, belief=belief)
    radii = [a.hypotheses[0].radius_px for a in answers]
    assert radii == sorted(radii)
    assert abs(answers[-1].hypotheses[0].position.x - 240.0) < RADIUS
    assert answers[-1].off_map_probability < 0.1


@pytest.mark.parametrize(("together", "surer"), [(1, 0.0), (4, 0.1)])
def test_it_is_hardly_surer_than_right_also_where_frames_err_together(together, surer):
    rng = np.random.default_rng(5)
    stated, right = [], []
    for start in (50, 300, 700):
        truth = line(start, 100)
        frames = []
        astray = np.repeat(rng.random(len(truth)) > 0.7, together)[: len(truth)]
        for at, wrong in zip(truth, astray, strict=True):
            x = 1900.0 - at[0] if wrong else at[0] + rng.normal(0.0, 6.0)
            frames.append(answer(place(float(x), p=0.7)))
        for joined, at in zip(walk(frames)[1], truth, strict=True):
            stated.append(joined.hypotheses[0].probability)
            right.append(math.dist(joined.hypotheses[0].position, at) <= RADIUS)
    assert 0.65 < np.mean(stated) <= np.mean(right) + surer
    assert np.mean(right) > 0.7


def test_positions_next_to_a_row_are_moved_towards_it_and_far_ones_are_not():
    _, (off_path,) = walk([answer(place(500.0, 125.0))])
    _, (far,) = walk([answer(place(500.0, 180.0))])
    assert off_path.hypotheses[0].position.y < 120.0
    assert off_path.hypotheses[0].position.x == pytest.approx(500.0, abs=0.5)
    assert far.hypotheses[0].position.y > 170.0


def test_votes_can_be_followed():
    def frame(x):
        vote = Hypothesis(1, "photo", MapPixel(x, 100.0), 0.3, None, None, (7,), None, 12)
        return Answer((vote,), None, 0.7, None, COUNTS)

    _, answers = walk([frame(100.0 + 10 * i) for i in range(10)])
    assert answers[-1].off_map_probability is None
    assert answers[-1].hypotheses[0].probability + answers[-1].other_probability == pytest.approx(1.0)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.lists(st.tuples(st.floats(0, 2000), st.floats(0, 200), st.floats(0, 1)), max_size=4),
        min_size=1,
        max_size=6,
    ),
    st.integers(1, 4),
)
def test_it_adds_up_to_one_and_survives_being_written(frames, top):
    belief = Belief()
    for frame in frames:
        total = sum(p for *_, p in frame) + 0.25
        given_answer = answer(*(place(x, y, p=p / total) for x, y, p in frame))
        belief, joined = filter_step(belief, given_answer, motion=MOTION, top=top)
        listed = [h.probability for h in joined.hypotheses]
        assert sum(listed) + joined.other_probability + joined.off_map_probability == pytest.approx(1.0)
        assert listed == sorted(listed, reverse=True) and len(listed) <= top
        assert belief_from_json(belief_to_json(belief)) == belief
