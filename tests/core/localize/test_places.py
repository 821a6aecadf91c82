"""Places from verified photos: if geometry gives no position, the photos of one place vote together."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.hypotheses.calibration import DEFAULT, probabilities
from webapp.core.localize.evidence import Spots, evidence_vectors, photo_spots, support
from webapp.core.localize.places import VerifiedPhoto, estimate_places, voters_of
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import ShortlistedPhoto


def the_map(*positions):
    """A map with photos at these positions and a place radius of 10."""
    return IndexedMap(
        ids=np.arange(len(positions)),
        position=np.array(positions, float),
        fov_deg=np.full(len(positions), 60.0),
        segments=[],
        photo_of_entry=np.zeros(0, np.int64),
        search=None,
        place_radius_px=10.0,
    )


def voted(photo, votes, pose=None):
    nothing = np.zeros((0, 2), np.float32)
    rows = np.zeros(0, np.int64)
    matched = ShortlistedPhoto(photo, votes, rows, rows, nothing, nothing)
    rays, depths = np.zeros((0, 3)), np.zeros(0)
    return VerifiedPhoto(matched, pose or NoPose("no matches"), rays, rays, depths, depths, (0.004, 0.004))


def seen(photo, bearing_deg, *, inliers=100, of=120):
    """Return a verified photo in a direction, with a number of inliers."""
    inlier = np.arange(of) < inliers
    pose = RelativePose(
        np.radians(bearing_deg), np.radians(5.0), inlier, np.eye(3), np.array([0.0, 0.0, 1.0])
    )
    return voted(photo, 1.0, pose)


def test_photos_of_one_place_vote_together():
    indexed = the_map((0, 0), (500, 0), (504, 0), (500, 4))
    checked = [voted(0, 4.0), voted(1, 3.0), voted(2, 3.0), voted(3, 3.0)]
    places = estimate_places(indexed, checked)
    assert [p.kind for p in places] == ["photo", "photo"]
    assert [p.position.x >= 500 for p in places] == [True, False]
    assert best_first(indexed, places, checked) == [0, 1]
    shares = support(indexed, voters_of(checked), at=photo_spots(indexed, np.array([1, 0])), reach=2.0)
    assert shares == pytest.approx([27 / 43, 16 / 43], abs=0.02)


def test_geometry_is_worth_more_than_votes():
    around = [(100, 92), (108, 100), (100, 108), (900, 900)]
    indexed = the_map(*around)
    checked = [seen(0, 0.0), seen(1, 90.0), seen(2, 180.0), voted(3, 40.0)]
    places = estimate_places(indexed, checked)
    best, *others = places
    assert best.kind == "position"
    assert np.hypot(best.position.x - 100, best.position.y - 100) < 5.0
    assert (900.0, 900.0) in [p.position for p in others]
    evidence = vectors(indexed, places, checked)
    assert evidence[0, 0] > 3.0 and not evidence[1:, 0].any()


def test_a_hair_of_geometry_does_not_outweigh_the_votes():
    indexed = the_map((0, 0), (500, 0), (504, 0))
    weak = seen(0, 0.0, inliers=12, of=60)
    checked = [weak, voted(1, 30.0), voted(2, 30.0)]
    places = estimate_places(indexed, checked)
    assert places[best_first(indexed, places, checked)[0]].position.x >= 500


def test_places_are_apart_and_nothing_gives_nothing():
    indexed = the_map(*[(3.0 * n, 0) for n in range(30)])
    places = estimate_places(indexed, [voted(n, 1.0 + n) for n in range(30)])
    x = sorted(p.position.x for p in places)
    assert len(places) > 1
    assert min(np.diff(x)) > 10.0
    assert estimate_places(indexed, []) == []


def test_where_photos_stand_for_areas_an_area_is_the_answer():
    indexed = replace(the_map((0, 0), (0, 0), (50, 0), (50, 0)), area=np.array([0, 0, 1, 1]))
    checked = [seen(2, 0.0), voted(0, 4.0), voted(1, 4.0)]
    places = estimate_places(indexed, checked)
    assert [(p.kind, p.position, p.heading) for p in places] == [
        ("area", (0.0, 0.0), None),
        ("area", (50.0, 0.0), None),
    ]
    assert [v.matched.photo for v in places[0].photos] == [0, 1]


def test_votes_are_compared_with_what_chance_gives():
    positions = [(100.0 * n, 0) for n in range(40)]
    together = the_map(*positions[:36], (5000, 0), (5001, 0), (5002, 0), (5003, 0))
    voters = voters_of([voted(n, 3.0) for n in (36, 37, 38, 39, 3, 12, 20, 28)])
    at = photo_spots(together, np.array([37, 12]))
    there, elsewhere = evidence_vectors(together, voters, at=at, score=[0.0, 0.0])
    assert there[2] > np.log(2.0) > 0.0 > elsewhere[2]


def vectors(indexed, places, checked):
    spots = Spots(np.array([p.position for p in places]), np.array([p.area for p in places]))
    return evidence_vectors(indexed, voters_of(checked), at=spots, score=[p.score for p in places])


def best_first(indexed, places, checked):
    """Return the order of places by probability."""
    return np.argsort(-probabilities(vectors(indexed, places, checked), DEFAULT)[0]).tolist()
