"""The camera, and where things are drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.sample.scene.camera import SceneCamera
from webapp.sample.scene.raster import Frame, Quad, Texture, draw_quad

RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)


def picture(left, right):
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, :32], image[:, 32:] = left, right
    return Texture.of(image)


def wall(*, north=10.0, size=4.0, texture=None, two_sided=False):
    """Return a wall north of the origin that faces south."""
    return Quad(
        np.array([-size / 2, north, 0.0]),
        np.array([size, 0.0, 0.0]),
        np.array([0.0, 0.0, size]),
        texture or picture(RED, BLUE),
        two_sided,
    )


def photograph(quads, camera):
    frame = Frame.empty(camera)
    for quad in quads:
        draw_quad(frame, camera, quad=quad, sun=1.0)
    return frame


LOOKING_NORTH = SceneCamera((0.0, 0.0, 2.0), 0.0, 90.0, 101, 101)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ((0, 10, 2), (50, 50)),  # straight ahead
        ((10, 10, 2), (100.5, 50)),  # 45 degrees to the right: the edge of a photo 90 degrees wide
        ((-5, 10, 2), (24.75, 50)),
        ((0, 10, 7), (50, 24.75)),  # up in the world is up in the photo
    ],
)
def test_points_appear_where_the_pinhole_puts_them(point, pixel):
    pixels, depth = LOOKING_NORTH.project(np.array([point], float))
    assert pixels[0] == pytest.approx(pixel)
    assert depth[0] == pytest.approx(10)


def test_heading_turns_clockwise():
    east = SceneCamera((0.0, 0.0, 2.0), 90.0, 90.0, 101, 101)
    pixels, depth = east.project(np.array([[10.0, 0.0, 2.0], [10.0, -5.0, 2.0]]))
    assert pixels[0] == pytest.approx((50, 50))
    assert pixels[1, 0] > 50  # facing east, south is to the right
    assert depth == pytest.approx([10, 10])


def test_looking_up_lowers_the_scene():
    up = SceneCamera((0.0, 0.0, 2.0), 0.0, 90.0, 101, 101, pitch_deg=10.0)
    pixels, _ = up.project(np.array([[0.0, 10.0, 2.0]]))
    assert pixels[0] == pytest.approx((50, 50 + up.focal_px * np.tan(np.radians(10))))


angles = st.floats(-180, 180)


@given(heading=angles, pitch=st.floats(-90, 90))
def test_the_rotation_is_one(heading, pitch):
    rotation = SceneCamera((0, 0, 0), heading, 60.0, 64, 48, pitch).camera_from_world
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


@given(
    east=st.floats(-6, 6),
    south=st.floats(-8, 6),
    up=st.floats(0.5, 6),
    heading=st.floats(-25, 25),
    pitch=st.floats(-10, 10),
)
def test_a_drawn_spot_is_seen_where_its_centre_projects(east, south, up, heading, pitch):
    camera = SceneCamera((east, south, up), heading, 80.0, 200, 150, pitch)
    spot = wall(north=12.0, size=0.6, texture=picture(GREEN, GREEN))
    expected, _ = camera.project((spot.corner + spot.along / 2 + spot.up / 2)[None])
    seen = np.argwhere(np.isfinite(photograph([spot], camera).depth))[:, ::-1]
    if not ((expected[0] > 12) & (expected[0] < (187, 137))).all():
        return
    assert len(seen) > 4
    assert seen.mean(axis=0) == pytest.approx(expected[0], abs=0.75)


def test_the_texture_is_not_mirrored_and_stands_upright():
    colours = photograph([wall()], LOOKING_NORTH).rgba()
    assert tuple(colours[48, 45, :3]) == RED
    assert tuple(colours[48, 55, :3]) == BLUE
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32] = GREEN
    top, bottom = photograph([wall(texture=Texture.of(image))], LOOKING_NORTH).rgba()[[42, 58], 50, :3]
    assert tuple(top) == GREEN
    assert tuple(bottom) == (0, 0, 0)


def test_the_nearer_wall_hides_the_other_whatever_comes_first():
    near, far = wall(north=5.0, texture=picture(GREEN, GREEN)), wall(north=10.0, size=30.0)
    for quads in ([near, far], [far, near]):
        frame = photograph(quads, LOOKING_NORTH)
        assert tuple(frame.rgba()[50, 50, :3]) == GREEN
        assert frame.depth[50, 50] == pytest.approx(5.0)
        assert frame.depth[50, 90] == pytest.approx(10.0)


@pytest.mark.parametrize("two_sided", [False, True])
def test_the_back_is_seen_of_two_sided_quads_only(two_sided):
    behind = SceneCamera((0.0, 20.0, 2.0), 180.0, 90.0, 101, 101)
    seen = np.isfinite(photograph([wall(two_sided=two_sided)], behind).depth)
    assert seen.any() == two_sided


def test_what_is_not_there_is_seen_through():
    image = np.full((64, 64, 4), 255, np.uint8)
    image[:, :32, 3] = 0
    depth = photograph([wall(texture=Texture.of(image))], LOOKING_NORTH).depth
    assert np.isinf(depth[50, 45])
    assert np.isfinite(depth[50, 55])


def test_a_wall_through_the_camera_is_cut_off_not_folded():
    outside = Quad(
        np.array([1.0, -5.0, 0.0]),
        np.array([0.0, 30.0, 0.0]),
        np.array([0.0, 0.0, 4.0]),
        picture(RED, RED),
        True,
    )
    seen = np.isfinite(photograph([outside], LOOKING_NORTH).depth)
    assert seen[:, 60:].any()
    assert not seen[:, :50].any()
