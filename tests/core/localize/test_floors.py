"""Photos of different floors are never one place, however close their positions are."""

from dataclasses import replace

import numpy as np
import pytest

from tests.core.localize.test_places import seen, the_map, voted
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.joint import cluster
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.places import PhotoGroups, describe_places, spacing_px
from webapp.core.hypotheses.priors import apply_path_prior, fit_path_prior
from webapp.core.hypotheses.sequence import Belief, filter_step, motion_model
from webapp.core.localize.evidence import nearness, photo_spots
from webapp.core.localize.places import estimate_places

COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)


def place(x, *, floor, p=0.4):
    return Hypothesis(1, "position", MapPixel(x, 0.0), p, 2.0, 90.0, (floor,), 30, 40, floor=floor)


def test_two_floors_have_the_place_radius_of_one_and_areas_of_their_own():
    walk = np.column_stack([np.arange(0.0, 400.0, 10.0), np.zeros(40)])
    above = walk + np.array([1.0, 0.0])
    floor = np.repeat([0, 1], 40)
    both, own = np.vstack([walk, above]), np.arange(80)
    size = (500, 500)
    one = describe_places(walk, trust=None, size=size)
    two = describe_places(both, trust=None, size=size, groups=PhotoGroups(own, floor))
    assert two.radius_px == one.radius_px == 20.0
    assert spacing_px(both) == 1.0
    stacked = np.zeros((28, 2))
    groups = PhotoGroups(np.arange(28), np.repeat([0, 1], 14))
    areas = describe_places(stacked, trust=None, size=size, groups=groups)
    assert areas.kind == "areas" and len(set(areas.area.tolist())) == 2


def test_the_same_votes_on_two_floors_are_two_places():
    indexed = replace(the_map((500, 0), (501, 0), (500, 0)), floor=np.array([0, 0, 2]))
    near = nearness(
        photo_spots(indexed, np.array([0])), photo_spots(indexed, np.array([1, 2])), reach_px=10.0
    )
    assert near[0, 0] > 0.9 and near[0, 1] == 0.0
    places = estimate_places(indexed, [voted(0, 4.0), voted(1, 3.0), voted(2, 3.5)])
    assert sorted(p.floor for p in places) == [0, 2]


def test_a_position_is_computed_from_photos_of_one_floor():
    around = [(100, 92), (108, 100), (100, 108)]
    indexed = replace(the_map(*around, *around), floor=np.array([3, 3, 3, 0, 0, 0]))
    views = [seen(0, 0.0), seen(1, 90.0), seen(2, 180.0), seen(3, 10.0)]
    best, *others = estimate_places(indexed, views)
    assert (best.kind, best.floor) == ("position", 3)
    assert [v.matched.photo for v in best.photos] == [0, 1, 2]
    assert [p.floor for p in others] == [0]


def test_hypotheses_of_two_floors_are_not_joined():
    spots = cluster([(0, place(5, floor=0)), (1, place(5, floor=1)), (2, place(6, floor=1))], 10.0)
    assert [len(spot.members) for spot in spots] == [1, 2]


def test_photos_of_another_floor_draw_no_position_to_their_path():
    row = np.column_stack([np.arange(0.0, 200.0, 2.0), np.zeros(100)])
    paths = fit_path_prior(row, place_radius_px=10.0, floor=np.ones(100, np.int64))
    off = MapPixel(100.0, 5.0)
    assert apply_path_prior(off, 25.0, paths=paths, floor=0)[0] == off
    assert abs(apply_path_prior(off, 25.0, paths=paths, floor=1)[0].y) < 4.0


def test_a_sequence_that_takes_the_stairs_forgets_the_floor_below():
    row = np.column_stack([np.arange(0.0, 400.0, 10.0), np.zeros(40)])
    motion = motion_model(fit_path_prior(row, place_radius_px=20.0))

    def frame(floor):
        return Answer((place(100, floor=floor, p=0.9),), 0.1, 0.0, None, COUNTS)

    belief = Belief()
    for floor in (0, 0, 0, 0, 1):
        belief, answer = filter_step(belief, frame(floor), motion=motion, top=5)
    assert {h.floor for h in answer.hypotheses} == {0, 1}
    for _ in range(6):
        belief, answer = filter_step(belief, frame(1), motion=motion, top=5)
    assert answer.hypotheses[0].floor == 1
    assert sum(h.probability for h in answer.hypotheses) <= 1.0 + 1e-9
    assert answer.hypotheses[0].probability == pytest.approx(0.9, abs=0.15)
