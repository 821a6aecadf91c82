"""Printed tags are found in photos, with corners to a fraction of a pixel."""

import math

import numpy as np
import pytest

from tests.core.tags.drawn import corners_of, looking, photo_of, tag_at
from webapp.core.mapmodel.control_points import TAG_FAMILIES
from webapp.core.tags.detect import find_tags, modules


def seen_from(distance, angle_deg, *, height=0.2):
    """Return the corners of a tag that faces south, from a distance and an angle to its normal."""
    angle = math.radians(angle_deg)
    centre = np.array([distance * math.sin(angle), distance * math.cos(angle), -height])
    rotation = looking(-angle, pitch=-height / distance, roll=0.1)
    return corners_of(tag_at((0, 0, 0), heading_deg=180.0), np.zeros(3), centre=centre, rotation=rotation)


@pytest.mark.parametrize("family", TAG_FAMILIES)
@pytest.mark.parametrize(("distance", "angle_deg"), [(1.5, 0.0), (2.5, 40.0), (5.0, -30.0)])
def test_corners_are_exact_to_a_tenth_of_a_pixel(family, distance, angle_deg):
    corners = seen_from(distance, angle_deg)
    [found] = find_tags(photo_of([(family, 7, corners)], seed=int(distance)), [family])
    assert (found.family, found.number) == (family, 7)
    assert np.sqrt(((found.corners - corners) ** 2).mean()) < 0.1


def test_the_middle_is_that_of_the_tag_and_not_of_its_picture():
    corners = seen_from(1.0, 55.0)
    tag = tag_at((0, 0, 0), heading_deg=180.0)
    angle = math.radians(55.0)
    centre, rotation = np.array([math.sin(angle), math.cos(angle), -0.2]), looking(-angle, -0.2, 0.1)
    own = rotation @ (tag.at - centre)
    [found] = find_tags(photo_of([("36h11", 3, corners)]), ["36h11"])
    at = 1000.0 * own[:2] / own[2] + [599.5, 449.5]
    assert found.middle == pytest.approx(tuple(at), abs=0.2)
    assert math.dist(corners.mean(0), at) > 1.0


def test_a_tag_of_another_family_is_not_found():
    photo = photo_of([("6x6_250", 7, seen_from(1.5, 0.0))])
    assert find_tags(photo, ["36h11"]) == []


def test_a_tag_that_is_there_twice_is_found_twice():
    one, aside = seen_from(2.0, 0.0), np.array([300.0, 0.0])
    photo = photo_of([("36h11", 7, one - aside), ("36h11", 7, one + aside)])
    assert [tag.number for tag in find_tags(photo, ["36h11"])] == [7, 7]


@pytest.mark.parametrize(("family", "side"), [("36h11", 8), ("4x4_50", 6), ("5x5_100", 7), ("6x6_250", 8)])
def test_the_pattern_has_a_black_border(family, side):
    pattern = modules(family, TAG_FAMILIES[family] - 1)
    assert pattern.shape == (side, side)
    assert pattern[[0, -1]].all() and pattern[:, [0, -1]].all() and not pattern.all()
