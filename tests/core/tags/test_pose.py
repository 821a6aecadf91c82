"""Cameras are solved from tags of known size at known positions, and their radii hold."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.core.tags.drawn import FOCAL, HEIGHT, WIDTH, corners_of, looking, tag_at
from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.landmarks.absolute_pose import Lens, euler_angles
from webapp.core.tags.pose import distance_to, mount_rotation, solve_by_tags

LENS = Lens(WIDTH, HEIGHT, FOCAL)
CENTRE = np.array([1.0, 3.0, -0.3])
ROTATION = looking(math.radians(-20.0), 0.05, 0.02)


def seen(tag, *, noise=0.0, rng=None, turned=None, at=None):
    at = tag.at if at is None else at
    corners = corners_of(tag, at, centre=CENTRE, rotation=ROTATION, turned=turned)
    return replace(tag, corners=corners + (rng.normal(0.0, noise, (4, 2)) if noise else 0.0))


def solved(tags, **options):
    found = solve_by_tags(tags, lens=replace(LENS, focal_sigma=options.pop("focal_sigma", 0.01)))
    assert not isinstance(found, NoPose), found
    return found


def test_one_tag_gives_position_and_heading():
    pose = solved([seen(tag_at((0, 0, 0), heading_deg=160.0))]).poses[0]
    assert pose.centre == pytest.approx(CENTRE, abs=0.01)
    assert np.degrees(euler_angles(pose.rotation)) == pytest.approx([-20.0, math.degrees(0.05), 1.1], abs=0.3)


def test_one_tag_on_the_floor_gives_position_and_heading():
    tag = tag_at((0.2, 0.5, 1.2), heading_deg=30.0, mount="floor", size_m=0.4)
    pose = solved([seen(tag)]).poses[0]
    assert pose.centre == pytest.approx(CENTRE, abs=0.02)


def test_two_tags_need_no_headings():
    tags = [tag_at((-0.5, 0, 0), heading_deg=170.0), tag_at((0.7, 0.3, 0.2), heading_deg=200.0)]
    shown = [replace(seen(tag), heading_rad=None) for tag in tags]
    pose = solved(shown).poses[0]
    assert pose.centre == pytest.approx(CENTRE, abs=0.02)
    assert euler_angles(pose.rotation)[0] == pytest.approx(math.radians(-20.0), abs=0.01)


def test_one_tag_without_a_heading_gives_only_its_distance():
    tag = replace(seen(tag_at((0, 0, 0), heading_deg=160.0)), heading_rad=None)
    assert not solve_by_tags([tag], lens=replace(LENS, focal_sigma=0.01))
    assert distance_to(tag, lens=LENS) == pytest.approx(math.hypot(1.0, 3.0), abs=0.03)


def test_a_small_tag_has_two_poses_and_both_are_returned():
    tag = tag_at((0, 0, 0), heading_deg=180.0, size_m=0.06)
    poses = solved([seen(tag, noise=0.2, rng=np.random.default_rng(1))]).poses
    assert len(poses) == 2
    assert sum(pose.weight for pose in poses) == pytest.approx(1.0)
    assert min(math.dist(pose.centre[:2], CENTRE[:2]) for pose in poses) < 0.5
    assert math.dist(poses[0].centre[:2], poses[1].centre[:2]) > 0.5


@pytest.mark.parametrize("moved", [0, 2])
def test_a_tag_that_was_moved_is_named(moved):
    at = [(-0.6, 0, 0), (0, -0.2, 0.3), (0.6, 0, 0), (1.2, 0.4, -0.2)]
    tags = [replace(tag_at(one, heading_deg=180.0), name=str(n)) for n, one in enumerate(at)]
    shown = [
        seen(tag, at=tag.at + np.array([0.0, 0.8, 0.0]) if n == moved else None) for n, tag in enumerate(tags)
    ]
    found = solved(shown)
    assert found.contradicting == (str(moved),)
    assert found.poses[0].centre == pytest.approx(CENTRE, abs=0.02)


def test_two_tags_that_contradict_each_other_give_both_places():
    tags = [replace(tag_at((x, 0, 0), heading_deg=180.0), name=str(x)) for x in (-0.5, 0.5)]
    found = solved([seen(tags[0]), seen(tags[1], at=tags[1].at + np.array([0.0, 1.5, 0.0]))])
    assert found.contradicting == ("-0.5", "0.5")
    assert {pose.tags for pose in found.poses} == {("-0.5",), ("0.5",)}


@pytest.mark.parametrize(
    ("count", "distance", "focal_sigma", "headings"),
    [(1, 2.0, 0.02, True), (1, 4.0, 0.1, True), (3, 4.0, 0.02, False), (3, 4.0, 0.1, True)],
)
def test_the_radius_holds_where_all_is_as_uncertain_as_stated(count, distance, focal_sigma, headings):
    rng = np.random.default_rng(5)
    held = [_is_held(count, distance, focal_sigma=focal_sigma, headings=headings, rng=rng) for _ in range(50)]
    assert 0.54 <= np.mean(held) <= 0.9


def _is_held(count, distance, *, focal_sigma, headings, rng):
    angle = math.radians(rng.uniform(-50.0, 50.0))
    centre = np.array([distance * math.sin(angle), distance * math.cos(angle), rng.normal(0.0, 0.3)])
    rotation = looking(-angle + rng.normal(0.0, 0.05), rng.normal(0.0, 0.05), rng.normal(0.0, 0.05))
    tags = []
    for _ in range(count):
        across = rng.uniform(-0.2, 0.2) * distance if count > 1 else 0.0
        stated = tag_at((across, 0.0, rng.normal(0.0, 0.2)), heading_deg=180.0, sigma_m=0.02)
        turned = mount_rotation("wall", math.pi) @ so3.exp(np.radians(rng.normal(0.0, [2.0, 3.0, 2.0])))
        at = stated.at + rng.normal(0.0, [0.02, 0.02, 0.05])
        corners = corners_of(stated, at, centre=centre, rotation=rotation, turned=turned)
        heading = stated.heading_rad if headings else None
        tags.append(replace(stated, corners=corners + rng.normal(0.0, 0.2, (4, 2)), heading_rad=heading))
    lens = replace(LENS, focal_px=FOCAL * math.exp(rng.normal(0.0, focal_sigma)), focal_sigma=focal_sigma)
    found = solve_by_tags(tags, lens=lens)
    # the radius is stated for the case that the hypothesis is right
    off, radius = min((math.dist(p.centre[:2], centre[:2]), p.radius_m) for p in found.poses)
    return off <= radius
