"""The way through the photos of a map, for layouts with obvious answers."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.core.mapmodel.walk import APART_DEG, STEPS, Stop, plan_walk

NORTH, EAST, SOUTH, WEST = 0.0, 90.0, 180.0, 270.0


def path(count, **facts):
    """Photos along a straight path to the east, 10 m apart, which look along it."""
    return [Stop(n, 10.0 * n, 0.0, heading_deg=EAST, **facts) for n in range(count)]


def steps_of(stops, id):
    return {step.id: step for step in plan_walk(stops).steps[id]}


def test_no_photo_gives_an_empty_walk():
    walk = plan_walk([])
    assert (walk.by_time, walk.by_place, dict(walk.steps)) == ((), (), {})


def test_one_photo_leads_nowhere():
    assert plan_walk([Stop(3, 5.0, 5.0)]).steps == {3: ()}


def test_times_give_the_order_and_photos_without_one_follow_as_a_tour():
    stops = [
        Stop(0, 0.0, 0.0, taken_at="2024-05-01T12:02:00"),
        Stop(1, 50.0, 0.0),
        Stop(2, 10.0, 0.0, taken_at="2024-05-01T12:01:00"),
        Stop(3, 20.0, 0.0),
    ]
    assert plan_walk(stops).by_time == (2, 0, 3, 1)


def test_without_times_there_is_no_order_by_time():
    assert plan_walk(path(3)).by_time == ()


def test_a_tour_follows_a_path_from_one_end_to_the_other():
    mixed = [path(40)[n] for n in np.random.default_rng(0).permutation(40)]
    assert plan_walk(mixed).by_place in (tuple(range(40)), tuple(range(39, -1, -1)))


def test_a_tour_visits_the_floors_from_the_lowest():
    stops = [Stop(n, float(n % 5), 0.0, floor=n // 5, level=(1.0, -1.0)[n // 5]) for n in range(10)]
    tour = plan_walk(stops).by_place
    assert {*tour[:5]} == {5, 6, 7, 8, 9}
    assert {*tour[5:]} == {0, 1, 2, 3, 4}


def test_steps_lead_along_a_path_in_both_directions():
    steps = steps_of(path(10), 4)
    assert {id: step.bearing_deg for id, step in steps.items()} == {3: WEST, 5: EAST}
    assert steps[5].distance == 10.0


def test_steps_prefer_photos_that_look_the_same_way():
    stops = [*path(3), Stop(9, 10.5, 0.0, heading_deg=WEST)]
    assert 1 in steps_of(stops, 0)
    assert 9 not in steps_of(stops, 0)


def test_steps_do_not_leave_the_floor():
    stops = [*path(2), Stop(7, 5.0, 1.0, floor=1, level=1.0)]
    assert set(steps_of(stops, 0)) == {1}


def test_photos_on_one_spot_are_turns_and_those_that_look_the_same_way_are_left_out():
    around = [Stop(n, 0.0, 0.0, heading_deg=heading) for n, heading in enumerate((NORTH, EAST, WEST, 5.0))]
    steps = steps_of([*around, Stop(8, 0.0, 10.0, heading_deg=NORTH)], 0)
    assert {id: (step.bearing_deg, step.distance) for id, step in steps.items()} == {
        1: (EAST, 0.0),
        2: (WEST, 0.0),
        8: (NORTH, 10.0),
    }


def test_a_step_is_not_much_longer_than_usual():
    assert plan_walk([*path(5), Stop(9, 1000.0, 0.0)]).steps[4][0].id == 3
    assert 9 not in {step.id for step in plan_walk([*path(5), Stop(9, 1000.0, 0.0)]).steps[4]}


def test_many_photos_on_a_spot_do_not_hide_the_next_one():
    stops = [Stop(n, 10.0 * (n // 90), 0.0, heading_deg=EAST + 0.1 * (n % 90)) for n in range(180)]
    (step,) = plan_walk(stops).steps[22]
    assert (step.id, step.bearing_deg) == (112, pytest.approx(EAST))  # the photo that looks the same way
    assert plan_walk(stops).by_place in (tuple(range(180)), (*range(90, 180), *range(90)))


def test_many_photos_on_a_spot_cost_no_more_than_as_many_spots():
    def seconds(positions):
        stops = [Stop(n, *at, heading_deg=n % 360) for n, at in enumerate(positions.tolist())]
        begun = time.process_time()
        plan_walk(stops)
        return time.process_time() - begun

    spread = np.random.default_rng(0).uniform(0, 1000, (6000, 2))
    for spots in (1, 60):
        assert seconds(spread[np.arange(6000) % spots]) < 2.0 * seconds(spread)


COORDINATES = st.floats(-1e5, 1e5, width=32)
HEADINGS = st.none() | st.floats(0, 359)
PLACES = st.lists(st.tuples(COORDINATES, COORDINATES, HEADINGS, st.integers(0, 2)), max_size=60)


@given(PLACES)
@settings(max_examples=60, deadline=None)
def test_orders_have_every_photo_once_and_steps_are_few_and_apart(places):
    stops = [
        Stop(n, east, north, floor=floor, level=float(floor), heading_deg=heading)
        for n, (east, north, heading, floor) in enumerate(places)
    ]
    walk = plan_walk(stops)
    assert sorted(walk.by_place) == sorted(walk.steps) == list(range(len(stops)))
    for id, steps in walk.steps.items():
        assert id not in {step.id for step in steps}
        assert len(steps) <= STEPS
        bearings = [step.bearing_deg for step in steps]
        for n, one in enumerate(bearings):
            for other in bearings[:n]:
                assert abs((one - other + 180) % 360 - 180) >= APART_DEG
