"""Association of detections without an id to objects."""

import itertools

import numpy as np
import pytest
from pyproj import Geod

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.association import MIN_SIGMA_M, ObjectAssociation, ObjectEstimate
from webapp.missions.core.trajectory.records import Sighting

WGS84 = Geod(ellps="WGS84")
ORIGIN = (50.0, 14.0)


def seen_at(east, north=0.0, *, time_s=0.0, kind="victim", sigma=1.0, origin=ORIGIN):
    """Return a detection at an offset from the origin, metres."""
    lat, lon = origin
    lon, lat, _ = WGS84.fwd(lon, lat, np.degrees(np.arctan2(east, north)), np.hypot(east, north))
    covariance = None if sigma is None else (sigma**2, sigma**2, 0.0)
    return Sighting(None, kind, time_s, LatLon(lat, lon), covariance_m2=covariance)


@pytest.fixture
def association():
    numbers = itertools.count(1)
    return ObjectAssociation(lambda kind: f"{kind} #{next(numbers)}")


def noisy(rng, *, centres, count, sigma, kind="victim"):
    """Return alternating noisy detections of objects, each with the number of its object."""
    noise = rng.normal(0, sigma, (count, len(centres), 2))
    return [
        (o, seen_at(centre + e, n, time_s=10.0 * k + 3.0 * o, sigma=sigma, kind=kind))
        for k, frame in enumerate(noise)
        for o, (centre, (e, n)) in enumerate(zip(centres, frame, strict=True))
    ]


@pytest.mark.parametrize("sigma", [1.0, 3.0])
def test_two_objects_30_m_apart_with_noise_are_two(association, sigma):
    made = noisy(np.random.default_rng(4), centres=(0.0, 30.0), count=20, sigma=sigma)
    ids = association.join([one for _, one in made])
    assert {(o, id) for (o, _), id in zip(made, ids, strict=True)} == {(0, "victim #1"), (1, "victim #2")}
    for centre, id in ((0.0, "victim #1"), (30.0, "victim #2")):
        found = association.estimate("victim", id)
        truth = seen_at(centre).latlon
        off_m = WGS84.inv(truth.lon, truth.lat, found.latlon.lon, found.latlon.lat)[2]
        assert off_m < 3 * sigma / np.sqrt(20)
        expected = (sigma**2 + MIN_SIGMA_M**2) / 20
        assert found.covariance_m2 == pytest.approx((expected, expected, 0.0))


def test_most_simulated_runs_find_just_the_objects_there_are():
    found = []
    for seed in range(40):
        numbers = itertools.count(1)
        made = noisy(np.random.default_rng(seed), centres=(0.0, 30.0), count=20, sigma=3.0)
        join = ObjectAssociation(lambda kind, n=numbers: f"{kind} #{next(n)}").join
        found.append(len(set(join([one for _, one in made]))))
    assert found.count(2) >= 36


def test_classes_are_never_joined(association):
    seen = [seen_at(0, time_s=n, kind=kind) for n, kind in enumerate(("car", "victim", "car", "door"))]
    assert association.join(seen) == ["car #1", "victim #2", "car #1", "door #3"]


def test_detections_at_one_time_are_different_objects(association):
    assert len(set(association.join([seen_at(0), seen_at(0.5), seen_at(-0.5)]))) == 3


def test_pairs_of_one_picture_are_those_that_fit_best(association):
    left, right = association.join([seen_at(0.0), seen_at(2.0)])
    assert association.join([seen_at(1.4, time_s=1), seen_at(2.6, time_s=1)]) == [left, right]


def degrees(count, *, step, begin=0.0, time_s=0.0):
    """Return simultaneous detections in a row to the north."""
    return [Sighting(None, "victim", time_s, LatLon(begin + step * n, 14.0)) for n in range(count)]


def test_a_picture_of_5000_new_objects_far_from_5000_known_ones_is_no_work_to_assign(association):
    known = association.join(degrees(5000, step=0.001))
    found = association.join(degrees(5000, step=0.001, begin=-10.0, time_s=1.0))
    assert len({*known, *found}) == 10_000


def test_a_picture_of_2000_objects_that_are_all_near_each_other_is_assigned(association):
    known = association.join(degrees(1000, step=1e-6))
    found = association.join(degrees(2000, step=1e-6, time_s=1.0))
    assert len(set(found)) == 2000
    assert found[:1000] == known


def test_the_order_within_a_batch_does_not_matter():
    made = [one for _, one in noisy(np.random.default_rng(5), centres=(0.0, 12.0), count=10, sigma=1.5)]
    results = []
    for order in (range(20), reversed(range(20)), np.random.default_rng(1).permutation(20)):
        numbers = itertools.count(1)
        places = list(order)
        ids = ObjectAssociation(lambda kind, n=numbers: f"{kind} #{next(n)}").join([made[p] for p in places])
        results.append(dict(zip(places, ids, strict=True)))
    assert results[0] == results[1] == results[2]


def test_what_comes_again_is_known(association):
    seen = [seen_at(0), seen_at(20), seen_at(0.3, time_s=5)]
    association.join(seen)
    before = association.estimate("victim", "victim #1")
    assert association.join(seen) == [None, None, None]
    assert association.estimate("victim", "victim #1") == before


def test_the_gate_widens_with_the_accuracy_and_the_time_that_has_gone_by(association):
    association.join([seen_at(0, sigma=0.1)])
    assert association.join([seen_at(6, time_s=1, sigma=0.1)]) == ["victim #2"]
    assert association.join([seen_at(-6, time_s=1000, sigma=0.1)]) == ["victim #1"]
    assert association.join([seen_at(300, time_s=2, sigma=100.0)]) == ["victim #2"]
    assert association.join([seen_at(-60, time_s=3, sigma=None)]) == ["victim #3"]


def test_objects_of_before_are_known_and_what_was_seen_at_the_same_time_is_another(association):
    known = ObjectEstimate("victim #9", "victim", seen_at(0).latlon, (1.0, 1.0, 0.0), 0.0, 50.0)
    association.add(known)
    association.add_seen(known, time_s=50.0, latlon=known.latlon)
    assert association.join([seen_at(1, time_s=50.0), seen_at(0, time_s=50.0)]) == ["victim #1", None]
    assert association.join([seen_at(-1, time_s=51.0)]) == ["victim #9"]


@pytest.mark.parametrize("origin", [(10.0, 180.0), (-89.9, 20.0), (0.0, 0.0)])
def test_it_holds_at_the_180th_meridian_and_near_a_pole(association, origin):
    seen = [seen_at(e, time_s=n, origin=origin) for n, e in enumerate((1.0, -1.0, 0.5, 60.0))]
    assert association.join(seen) == ["victim #1"] * 3 + ["victim #2"]
    found = association.estimate("victim", "victim #1").latlon
    assert WGS84.inv(origin[1], origin[0], found.lon, found.lat)[2] == pytest.approx(0.17, abs=0.01)
