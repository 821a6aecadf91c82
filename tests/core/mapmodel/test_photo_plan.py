"""How well places are recognised, and where the next photos help, for layouts with obvious answers."""

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.core.mapmodel import photo_plan
from webapp.core.mapmodel.photo_plan import plan_spots, short_walk, walk_length
from webapp.core.mapmodel.recognition import PhotoTrials, Rectangle, estimate_recognition

IMAGE = Rectangle(0, 0, 1000, 600)
RADIUS = 20.0
NORTH, EAST, SOUTH, WEST = 0, 2, 4, 6


def photos(rows, ids=None):
    """Make photos from (x, y, heading or None, success or None); without ids, each row is one photo."""
    table = np.array([[math.nan if value is None else value for value in row] for row in rows], np.float64)
    table = table.reshape(-1, 4)
    numbers = np.arange(len(table)) if ids is None else np.array(ids)
    return PhotoTrials(table[:, :2], table[:, 2], table[:, 3], numbers)


def all_around(x, y, success=None):
    return [(x, y, heading, success) for heading in range(0, 360, 45)]


def cell_of(grid, x, y):
    return int(np.hypot(*(grid.cell - (x, y)).T).argmin())


def estimate(rows, **more):
    return estimate_recognition(photos(rows), radius=RADIUS, image=IMAGE, **more)


def test_cells_are_near_photos_and_on_the_image():
    grid = estimate([(5, 5, 0, None), (502.5, 302.5, 0, None)])
    away = np.minimum(np.hypot(*(grid.cell - (5, 5)).T), np.hypot(*(grid.cell - (502.5, 302.5)).T))
    assert away.max() <= RADIUS + grid.side
    assert (grid.cell >= 0).all()
    assert grid.wanted.all()


def test_a_photo_speaks_for_its_place_and_direction():
    grid = estimate([(502.5, 302.5, 90, None)])
    here, there = grid.mean[cell_of(grid, 502.5, 302.5)], grid.mean[cell_of(grid, 520, 302.5)]
    assert here[EAST] > 0.7
    assert here[EAST] > here[NORTH] == pytest.approx(here[SOUTH])
    assert here[WEST] < 0.01
    assert here[EAST] > there[EAST] > there[WEST]


def test_north_is_one_direction_from_both_sides():
    left, right = (estimate([(502.5, 302.5, heading, None)]).mean for heading in (-10.0, 350.0))
    assert left == pytest.approx(right)


def test_trials_count_more_the_more_there_are():
    rows = [(502.5, 302.5, 90, 0.0)]
    means = [estimate(rows * count).mean[cell_of(estimate(rows), 502.5, 302.5), EAST] for count in (1, 3, 9)]
    assert means[0] > means[1] > means[2]
    assert means[2] < 0.2
    won = estimate([(502.5, 302.5, 90, 1.0)] * 9)
    lost = estimate(rows * 9)
    untried = estimate([(502.5, 302.5, 90, None)] * 9)
    here = cell_of(won, 502.5, 302.5)
    assert won.mean[here, EAST] > 0.9
    assert won.sigma[here, EAST] < untried.sigma[here, EAST]
    assert lost.share < untried.share < won.share


def test_a_trial_of_unknown_direction_counts_for_all():
    grid = estimate([(502.5, 302.5, None, 0.0)] * 9)
    assert grid.mean[cell_of(grid, 502.5, 302.5)] == pytest.approx(grid.mean[cell_of(grid, 502.5, 302.5), 0])
    assert grid.mean[cell_of(grid, 502.5, 302.5)].max() < 0.2


def test_a_hidden_panorama_is_one_trial_and_not_found_by_itself():
    rows = all_around(502.5, 302.5, 0.0)
    grids = [
        estimate_recognition(photos(rows, ids), radius=RADIUS, image=IMAGE) for ids in ([7] * 8, range(8))
    ]
    panorama, photos_of_it = (grid.factor[cell_of(grid, 502.5, 302.5)] for grid in grids)
    assert panorama == pytest.approx(1.0, abs=0.01), "nobody else was there to recognise it"
    assert photos_of_it.max() < 0.8
    two = [*rows, (503.5, 302.5, 0, None)]
    one, many = (
        estimate_recognition(photos(two, ids), radius=RADIUS, image=IMAGE)
        for ids in ([7] * 8 + [9], [7] + [8] * 7 + [9])
    )
    here = cell_of(one, 502.5, 302.5)
    assert many.factor[here, NORTH] < one.factor[here, NORTH] < 1.0


@pytest.mark.parametrize("at", [(1000, 600), (999, 300), (0, 0), (500, 600)])
def test_a_photo_at_the_edge_of_the_image_counts(at):
    grid = estimate_recognition(photos([(*at, 0, None)]), radius=23.0, image=IMAGE)
    assert IMAGE.holds(grid.cell).all()
    assert grid.mean[cell_of(grid, *at), NORTH] > 0.5


def test_an_area_is_estimated_also_where_nobody_was():
    area = Rectangle(600, 100, 800, 300)
    grid = estimate([(502.5, 302.5, 0, None)], area=area)
    assert area.holds(grid.cell[grid.wanted]).all()
    assert len(grid.cell) > grid.wanted.sum()
    assert grid.share < 0.01


def test_a_large_map_has_coarser_cells():
    rows = [(x, y, 0, None) for x in range(0, 1000, 10) for y in range(0, 600, 10)]
    grid = estimate_recognition(photos(rows), radius=4.0, image=IMAGE)
    assert 500 < len(grid.cell) <= 1500
    assert grid.kernel.length == grid.side > 2.0


def test_the_direction_that_is_missing_is_planned_first():
    rows = [row for x in range(100, 900, 15) for row in all_around(x, 300, 1.0)]
    rows = [row for row in rows if not (390 <= row[0] <= 510 and row[2] in (135, 180, 225))]
    found = plan_spots(estimate(rows), photos(rows), count=1)
    assert found[0].position[0] == pytest.approx(450, abs=RADIUS)
    assert found[0].headings_deg[0] == 180
    assert found[0].reason == "direction"


def test_no_spot_is_planned_where_nothing_is_gained():
    rows = [row for _ in range(12) for row in all_around(502.5, 302.5, 1.0)]
    area = Rectangle(500, 300, 506, 306)
    assert plan_spots(estimate(rows, area=area), photos(rows), count=5) == []


def test_reasons():
    one_way = [(x, 300, 90, None) for x in range(100, 300, 15)]
    lost = [row for x in range(500, 560, 15) for row in all_around(x, 300, 0.0)]
    reasons = {
        spot.reason: spot for spot in plan_spots(estimate(one_way + lost), photos(one_way + lost), count=100)
    }
    assert set(reasons) >= {"one-direction", "not-recognised"}
    assert reasons["one-direction"].position[0] < 330
    near = [(one_way + lost)[n] for n in reasons["not-recognised"].photos]
    assert near
    assert all(success == 0.0 for *_, success in near)
    bare = plan_spots(estimate(lost, area=Rectangle(800, 100, 900, 200)), photos(lost), count=1)
    assert [(spot.reason, spot.photos) for spot in bare] == [("few-photos", ())]


def test_spots_are_apart_and_their_gains_add_up_to_less_than_what_is_missing():
    rows = [(x, 300, 90, 1.0) for x in range(100, 900, 25)]
    grid = estimate(rows)
    few, many = plan_spots(grid, photos(rows), count=4), plan_spots(grid, photos(rows), count=12)
    assert (len(few), len(many)) == (4, 12)
    at = np.array([spot.position for spot in many])
    apart = np.hypot(*(at[:, None] - at).transpose(2, 0, 1)) + 1e9 * np.eye(12)
    assert apart.min() > RADIUS
    assert 0 < sum(s.gain for s in few) < sum(s.gain for s in many) < 1 - grid.share
    assert all(1 <= len(spot.headings_deg) <= 4 for spot in many)


def test_a_map_without_directions_is_photographed_all_around():
    rows = [(x, 300, None, None) for x in range(100, 900, 25)]
    found = plan_spots(estimate(rows), photos(rows), count=5)
    assert [spot.headings_deg for spot in found] == [()] * 5
    assert plan_spots(estimate([]), photos([]), count=5) == []


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), min_size=1, max_size=5, unique=True))
@settings(max_examples=40, deadline=None)
def test_a_walk_visits_all_and_is_nearly_the_shortest(points):
    at = np.array(points, np.float64)
    walk = short_walk(at)
    assert sorted(walk) == list(range(len(points)))
    best = min(walk_length(at[list(order)]) for order in permutations(range(len(points))))
    assert walk_length(at[walk]) <= 1.2 * best + 1e-9


def test_a_long_walk_takes_few_steps(monkeypatch):
    calls = []

    def counted(apart, real=photo_plan._saved):
        calls.append(len(apart))
        return real(apart)

    monkeypatch.setattr(photo_plan, "_saved", counted)
    at = np.random.default_rng(3).uniform(0, 1000, (100, 2))
    walk = short_walk(at)
    assert sorted(walk) == list(range(100))
    assert walk_length(at[walk]) < 0.93 * np.sqrt(100 * 1e6)
    assert len(calls) < 1000
