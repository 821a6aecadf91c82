"""The kind of map derived from its positions, and its place radius."""

import numpy as np
import pytest

from webapp.core.hypotheses.places import describe_places

SIZE = {"size": (2000, 1000)}
STANDS = np.repeat([[100.0 * n, 50.0] for n in range(20)], 5, axis=0)
"""A panorama of five photos at each of 20 places."""

FLOORS = np.repeat([[300.0 * n, 900.0] for n in range(5)], 40, axis=0)
"""Five floors with 40 photos each."""


def trusted(positions, share):
    return np.where(np.arange(len(positions)) < share * len(positions), 5.0, 0.0)


def test_photos_that_stand_alone_are_metric():
    walk = np.array([[10.0 * n, 0.0] for n in range(50)])
    found = describe_places(walk, trust=None, **SIZE)
    assert (found.kind, found.radius_px) == ("metric", 20.0)
    assert (found.area == -1).all()


def test_panoramas_that_relative_poses_confirm_are_metric():
    found = describe_places(STANDS, trust=trusted(STANDS, 0.9), **SIZE)
    assert (found.kind, found.radius_px) == ("metric", 200.0)


def test_shared_positions_that_relative_poses_contradict_are_areas():
    found = describe_places(STANDS, trust=trusted(STANDS, 0.2), **SIZE)
    assert (found.kind, found.radius_px) == ("areas", pytest.approx(40.0))
    assert len(set(found.area.tolist())) == 20


def test_photos_that_no_other_shows_the_same_as_contradict_nothing():
    confirmed = np.arange(len(STANDS)) < 30
    partner = np.where(confirmed, np.roll(np.arange(len(STANDS)), -5), -1)
    trust = np.where(confirmed, 5.0, 0.0)
    assert describe_places(STANDS, trust=trust, partner=partner, **SIZE).kind == "metric"
    assert describe_places(STANDS, trust=0.0 * trust, partner=partner, **SIZE).kind == "areas"
    few = np.where(np.arange(len(STANDS)) < 9, partner, -1)
    assert describe_places(STANDS, trust=trust, partner=few, **SIZE).kind == "areas"


def test_more_photos_than_a_panorama_has_are_an_area_whatever_their_poses():
    found = describe_places(FLOORS, trust=trusted(FLOORS, 1.0), **SIZE)
    assert (found.kind, found.radius_px) == ("areas", pytest.approx(120.0))


def test_a_map_of_both_is_mixed_and_its_radius_between():
    both = np.concatenate([STANDS, FLOORS])
    found = describe_places(both, trust=trusted(both, 1.0), **SIZE)
    assert found.kind == "mixed"
    assert (found.area[:100] == -1).all() and (found.area[100:] >= 0).all()
    assert 120.0 < found.radius_px < 200.0


@pytest.mark.parametrize("kind", ["metric", "areas", "schematic"])
def test_the_user_knows_better(kind):
    found = describe_places(STANDS, trust=None, kind=kind, **SIZE)
    assert found.kind == kind
    assert (found.area >= 0).all() == (kind == "areas")


def test_a_map_without_photos_has_a_kind_too():
    assert describe_places(np.zeros((0, 2)), trust=None, **SIZE).kind == "metric"


def test_noisy_positions_widen_the_radius_to_the_distance_between_photos_of_one_view():
    walk = np.array([[10.0 * n, 0.0] for n in range(50)])
    noisy = walk + np.random.default_rng(3).normal(0.0, 60.0, walk.shape)
    partner = np.array([1, *range(49)])
    exact = describe_places(walk, trust=None, partner=partner, **SIZE)
    blurred = describe_places(noisy, trust=None, partner=partner, **SIZE)
    assert exact.radius_px == 20.0
    assert 60.0 < blurred.radius_px < 150.0
    few = np.where(np.arange(50) < 9, partner, -1)
    assert describe_places(noisy, trust=None, partner=few, **SIZE).radius_px < 60.0
