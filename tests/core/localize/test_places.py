"""Places from verified photos: where geometry says nothing, the photos of one place vote together."""

import numpy as np
import pytest

from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.localize.places import VerifiedPhoto, estimate_places
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.shortlist import ShortlistedPhoto


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
    """A photo in that direction, with so many inliers."""
    inlier = np.arange(of) < inliers
    pose = RelativePose(
        np.radians(bearing_deg), np.radians(5.0), inlier, np.eye(3), np.array([0.0, 0.0, 1.0])
    )
    return voted(photo, 1.0, pose)


def test_photos_of_one_place_vote_together():
    indexed = the_map((0, 0), (500, 0), (504, 0), (500, 4))
    places = estimate_places(indexed, [voted(0, 5.0), voted(1, 3.0), voted(2, 3.0), voted(3, 3.0)])
    assert [p.kind for p in places] == ["photo", "photo"]
    assert [p.position.x >= 500 for p in places] == [True, False]
    assert places[0].support == pytest.approx(9 / 14, abs=0.02)
    assert places[0].merit > places[1].merit > 0.0 == places[0].score


def test_geometry_is_worth_more_than_votes():
    around = [(100, 92), (108, 100), (100, 108), (900, 900)]
    indexed = the_map(*around)
    checked = [seen(0, 0.0), seen(1, 90.0), seen(2, 180.0), voted(3, 40.0)]
    best, other = estimate_places(indexed, checked)[:2]
    assert best.kind == "position"
    assert np.hypot(best.position.x - 100, best.position.y - 100) < 5.0
    assert other.position == (900.0, 900.0)
    assert other.support > best.support


def test_a_hair_of_geometry_does_not_outweigh_the_votes():
    indexed = the_map((0, 0), (500, 0), (504, 0))
    weak = seen(0, 0.0, inliers=12, of=60)
    assert estimate_places(indexed, [weak, voted(1, 30.0), voted(2, 30.0)])[0].position.x >= 500


def test_places_are_apart_and_nothing_gives_nothing():
    indexed = the_map(*[(3.0 * n, 0) for n in range(30)])
    places = estimate_places(indexed, [voted(n, 1.0 + n) for n in range(30)])
    x = sorted(p.position.x for p in places)
    assert len(places) > 1
    assert min(np.diff(x)) > 20.0
    assert estimate_places(indexed, []) == []
