"""Photos of the park: consistent with its geometry, similar only at the same place."""

import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from webapp.sample.scene.camera import SceneCamera, map_views
from webapp.sample.scene.plan import DEPTH_M, PATH_WIDTH_M, WIDTH_M, draw_plan, nearest
from webapp.sample.scene.render import overhead, render
from webapp.sample.scene.solids import wall_height
from webapp.sample.scene.stage import AFTERNOON, AUTUMN, EVENING, OVERCAST, set_stage
from webapp.sample.scene.world import build_world

SIZE = {"fov_deg": 66.0, "width": 640, "height": 480}
METRES_PER_PIXEL = 0.25


@pytest.fixture(scope="module")
def world():
    return build_world(np.random.default_rng(7))


@pytest.fixture(scope="module")
def stage(world):
    return set_stage(np.random.default_rng(1), world, light=AFTERNOON)


@pytest.fixture(scope="module")
def from_above(stage):
    return overhead(stage, METRES_PER_PIXEL, rng=np.random.default_rng(2))


def shoot(stage, camera, seed=0):
    return render(stage, camera, rng=np.random.default_rng(seed))


def front_of(house, *, distance, aside=0.0, turn_deg=0.0):
    """Return a camera facing the door side of a house."""
    spot = house.centre + house.facing * (house.depth / 2 + distance) + house.side * aside
    heading = np.degrees(np.arctan2(-house.facing[0], -house.facing[1])) + turn_deg
    return SceneCamera((float(spot[0]), float(spot[1]), 1.6), float(heading), 66.0, 640, 480)


def matches(first, second):
    sift = cv2.SIFT_create(1000)
    found = [
        sift.detectAndCompute(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), None) for photo in (first, second)
    ]
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    good = [a for a, b in pairs if a.distance < 0.75 * b.distance]
    return (
        np.array([found[0][0][match.queryIdx].pt for match in good]),
        np.array([found[1][0][match.trainIdx].pt for match in good]),
    )


def off_epipolar_line(first, second, xy1, xy2):
    """Return the Sampson distance to the true epipolar geometry, pixels."""
    rotation = second.camera_from_world @ first.camera_from_world.T
    shift = second.camera_from_world @ (np.array(first.position) - np.array(second.position))
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    inverse = np.linalg.inv(first.intrinsics)
    fundamental = inverse.T @ cross @ rotation @ inverse
    one, two = (np.column_stack([xy, np.ones(len(xy))]) for xy in (xy1, xy2))
    line2, line1 = one @ fundamental.T, two @ fundamental
    error = np.abs((two * line2).sum(axis=1))
    return error / np.sqrt((line1[:, :2] ** 2).sum(axis=1) + (line2[:, :2] ** 2).sum(axis=1))


def test_neighbouring_photos_match_as_their_true_poses_say(stage):
    views = map_views(np.random.default_rng(3), stage.world.plan, count=60)
    shares = []
    for number in (7, 9, 24, 31, 42):
        cameras = [view.camera(**SIZE) for view in views[number : number + 2]]
        xy1, xy2 = matches(*(shoot(stage, camera, seed) for seed, camera in enumerate(cameras)))
        fits = off_epipolar_line(*cameras, xy1, xy2) < 2.0
        assert fits.sum() >= 30, f"photos {number}, {number + 1}: {fits.sum()} of {fits.size} fit"
        shares.append(fits.mean())
    assert np.median(shares) > 0.6


def test_turning_on_the_spot_moves_the_photo_by_the_homography_of_the_turn(stage):
    first = map_views(np.random.default_rng(3), stage.world.plan, count=60)[30].camera(**SIZE)
    second = replace(first, heading_deg=first.heading_deg + 30)
    xy1, xy2 = matches(shoot(stage, first), shoot(stage, second, 1))
    turn = second.intrinsics @ second.camera_from_world @ first.camera_from_world.T
    expected = np.column_stack([xy1, np.ones(len(xy1))]) @ (turn @ np.linalg.inv(first.intrinsics)).T
    error = np.linalg.norm(expected[:, :2] / expected[:, 2:] - xy2, axis=1)
    assert (error < 1.5).sum() >= 30
    assert (error < 1.5).mean() > 0.6


def test_a_house_front_maps_between_two_photos_as_its_corners_do(stage):
    house = max(stage.world.plan.buildings, key=lambda h: h.width)
    cameras = front_of(house, distance=6.0), front_of(house, distance=8.0, aside=2.0, turn_deg=-12.0)
    left, right = house.corners()[:2]
    top = wall_height(house)
    corners = np.array([[*left, 0.0], [*right, 0.0], [*right, top], [*left, top]])
    seen = [camera.project(corners)[0] for camera in cameras]
    second_from_first, _ = cv2.findHomography(seen[0], seen[1])
    photos = [cv2.cvtColor(shoot(stage, c, seed), cv2.COLOR_RGB2GRAY) for seed, c in enumerate(cameras)]
    moved = cv2.warpPerspective(photos[0], second_from_first, (640, 480))
    part = np.zeros((480, 640), np.uint8)
    cv2.fillConvexPoly(part, seen[1].astype(np.int32), 255)
    part &= cv2.warpPerspective(np.full((480, 640), 255, np.uint8), second_from_first, (640, 480))
    assert (part > 0).sum() > 20_000
    assert np.corrcoef(moved[part > 0], photos[1][part > 0])[0, 1] > 0.7
    aside = np.roll(moved, 25, axis=1)
    assert np.corrcoef(aside[part > 0], photos[1][part > 0])[0, 1] < 0.5


def test_the_same_seed_gives_the_same_photo(stage):
    camera = replace(front_of(stage.world.plan.buildings[0], distance=7.0), width=160, height=120)
    again = set_stage(np.random.default_rng(1), build_world(np.random.default_rng(7)), light=AFTERNOON)
    assert (shoot(stage, camera) == shoot(again, camera)).all()
    assert (shoot(stage, camera) != shoot(stage, camera, 1)).any()


def test_light_changes_the_photo_as_it_should(stage):
    camera = front_of(stage.world.plan.buildings[0], distance=7.0, turn_deg=40.0)
    photos = {"afternoon": shoot(stage, camera).astype(float)}
    for name, light in (("evening", EVENING), ("overcast", OVERCAST), ("autumn", AUTUMN)):
        photos[name] = shoot(set_stage(np.random.default_rng(1), stage.world, light=light), camera).astype(
            float
        )
    red_by_blue = {name: photo[..., 0].mean() / photo[..., 2].mean() for name, photo in photos.items()}
    assert photos["evening"].mean() < photos["afternoon"].mean() - 10
    assert red_by_blue["evening"] > red_by_blue["afternoon"] > red_by_blue["overcast"]
    assert np.abs(photos["autumn"] - photos["afternoon"]).mean() > 10


def test_the_satellite_sees_everything_in_its_place(stage, from_above):
    plan = stage.world.plan
    assert from_above.shape == (DEPTH_M / METRES_PER_PIXEL, WIDTH_M / METRES_PER_PIXEL, 3)

    def colour(spot):
        x, y = int(spot[0] / METRES_PER_PIXEL), int((DEPTH_M - spot[1]) / METRES_PER_PIXEL)
        return from_above[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).astype(float).mean(axis=0)

    water = colour(plan.pond.mean(axis=0))
    assert water[2] > water[0] + 10
    trees = np.array([(tree.east, tree.north) for tree in plan.trees])
    clear = plan.loop[nearest(plan.loop, trees) > 5]
    gravel = np.median([colour(spot) for spot in clear], axis=0)
    assert gravel[0] > gravel[1] > gravel[2]  # sand, not grass
    for house in plan.buildings:
        roof = colour(house.centre + house.facing * house.depth / 4)
        assert roof[1] < 1.1 * roof[0], "a roof is not green"


@pytest.mark.parametrize("seed", range(6))
def test_nothing_stands_in_the_way(seed):
    plan = draw_plan(np.random.default_rng(seed))
    assert 5 <= len(plan.buildings) <= 8
    assert len(plan.trees) > 60
    for house in plan.buildings:
        assert house.distance(plan.paths).min() > PATH_WIDTH_M / 2
        assert house.distance(plan.pond).min() > 1
        assert (house.corners() > 0).all() and (house.corners() < (WIDTH_M, DEPTH_M)).all()
    trunks = np.array([(t.east, t.north) for t in plan.trees if t.kind not in {"bush", "flowers"}])
    assert nearest(trunks, plan.paths).min() > PATH_WIDTH_M / 2
    assert nearest(plan.pond, plan.paths).min() > PATH_WIDTH_M / 2


def test_another_seed_is_another_park():
    first, second = (draw_plan(np.random.default_rng(seed)) for seed in (1, 2))
    assert not np.allclose(first.buildings[0].centre, second.buildings[0].centre, atol=0.5)


def test_a_photo_is_taken_in_a_quarter_of_a_second(stage):
    camera = front_of(stage.world.plan.buildings[0], distance=9.0)
    seconds = []
    for _ in range(3):
        start = time.process_time()
        shoot(stage, camera)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.25
