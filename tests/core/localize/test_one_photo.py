"""One oriented photo gives a position if depths of its points are known, else the photo's own place."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.core.photos_in_a_room import RADIUS, Scene, tilted
from webapp.core.geometry.extrinsics import MapExtrinsics, empty_depths
from webapp.core.localize.places import VerifiedPhoto, estimate_places
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import ShortlistedPhoto

QUERY = (tilted(0.5, 0.05), np.array([25.0, -30.0]))
PHOTO = (tilted(0.3), np.array([0.0, 0.0]))


def places(*, depths, trust=5.0, wrong=()):
    """Return the places by one photo; some depths may be wrong by a factor, and the others or all unknown."""
    view = Scene(seed=6).view(0, PHOTO, QUERY, depths=depths)
    if len(wrong):
        view.inverse_depth[len(wrong) :] = np.nan
        view.inverse_depth[: len(wrong)] *= wrong
    rows = np.arange(len(view.query_ray))
    xy = np.zeros((len(rows), 2), np.float32)
    verified = VerifiedPhoto(
        ShortlistedPhoto(0, 5.0, rows, rows, xy, xy),
        replace(view.pose, bearing=math.pi),
        view.query_ray,
        view.photo_ray,
        view.inverse_depth,
        view.sigma,
        view.ray_sigma,
    )
    indexed = IndexedMap(
        ids=np.array([7]),
        position=PHOTO[1][None],
        fov_deg=np.array([60.0]),
        segments=[],
        photo_of_entry=np.zeros(0, np.int64),
        search=None,
        place_radius_px=RADIUS,
        extrinsics=MapExtrinsics(PHOTO[0][None], np.zeros(1), np.array([trust]), empty_depths()),
    )
    return estimate_places(indexed, [verified])


def test_depths_fix_a_position_with_its_heading():
    best, *others = places(depths=True)
    assert best.kind == "position"
    assert math.dist(best.position, QUERY[1]) < 0.1 * RADIUS
    assert best.heading == pytest.approx(0.5, abs=0.03)
    assert not others


@pytest.mark.parametrize(("depths", "trust"), [(False, 5.0), (True, 0.1)])
def test_without_depths_or_orientation_the_photo_is_named(depths, trust):
    best = places(depths=depths, trust=trust)[0]
    assert best.kind == "photo"
    assert best.position == (0.0, 0.0)
    assert best.heading is None


def test_two_depths_are_not_believed():
    assert places(depths=True, wrong=[2.0, math.nan, 2.0])[0].kind == "photo"


def test_depths_that_are_all_wrong_put_the_position_out_by_no_more_than_themselves():
    """For example, if two map photos are farther apart than their positions."""
    best = places(depths=True, wrong=np.full(60, 1.1))[0]
    assert best.kind == "position"
    assert math.dist(best.position, QUERY[1]) < 0.15 * math.dist(PHOTO[1], QUERY[1])
    assert best.heading == pytest.approx(0.5, abs=0.03)
