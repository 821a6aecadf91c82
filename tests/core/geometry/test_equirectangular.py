"""Level views of panoramas: their pixels show the directions given by the camera."""

import numpy as np
import pytest

from webapp.core.geometry.equirectangular import panorama_pixels, ray_of_panorama, view_pixels, view_size
from webapp.core.geometry.tilt import Tilt

PANORAMA = (3600, 1800)


@pytest.mark.parametrize("turn", [0.0, 60.0, 180.0, 300.0])
def test_a_pixel_of_a_view_looks_where_its_ray_points(turn):
    size = view_size(PANORAMA[0], 17)
    x, y, elevation = view_pixels(size, panorama=PANORAMA, turn_deg=turn)
    xy = np.array([[0.0, 0.0], [size.width - 1, 3.0], [100.0, size.height - 1]])
    for (column, row), ray in zip(xy.astype(int), size.camera.rays(xy), strict=True):
        heading = np.degrees(np.arctan2(ray[0], ray[2])) + turn
        above = np.degrees(np.arctan2(-ray[1], np.hypot(ray[0], ray[2])))
        # a pixel of the panorama is a tenth of a degree; its middle column is at longitude 0
        seen = (x[row, column] + 0.5) / 10.0 - 180.0
        assert (seen - heading + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-3)
        assert 90.0 - (y[row, column] + 0.5) / 10.0 == pytest.approx(above, abs=1e-3)
        assert elevation[row, column] == pytest.approx(above, abs=1e-4)


def test_the_middle_of_a_tilted_panorama_is_above_the_horizon_and_the_horizon_turns_counterclockwise():
    sine, cosine = np.sin(np.radians(12.0)), np.cos(np.radians(12.0))
    assert ray_of_panorama(0.5, 0.5, Tilt(pitch_deg=12.0)) == pytest.approx([0.0, -sine, cosine])
    assert ray_of_panorama(0.75, 0.5, Tilt(pitch_deg=12.0)) == pytest.approx([1.0, 0.0, 0.0])
    # to the right of the middle, the middle row is below the horizon, which is thus higher in the panorama
    assert ray_of_panorama(0.75, 0.5, Tilt(roll_deg=12.0)) == pytest.approx([cosine, sine, 0.0])
    assert ray_of_panorama(0.5, 0.5, Tilt(roll_deg=12.0)) == pytest.approx([0.0, 0.0, 1.0])


@pytest.mark.parametrize("tilt", [Tilt(12.0), Tilt(0.0, -30.0), Tilt(-75.0, 170.0)])
@pytest.mark.parametrize("turn", [0.0, 120.0])
def test_a_pixel_of_a_level_view_of_a_tilted_panorama_looks_where_its_ray_points(tilt, turn):
    size = view_size(PANORAMA[0], 17)
    xy = np.array([[0.0, 0.0], [size.width - 1, 3.0], [100.0, size.height - 1], [700.0, 500.0]])
    at, above = panorama_pixels(xy, size, panorama=PANORAMA, turn_deg=turn, tilt=tilt)
    x, y, elevation = view_pixels(size, panorama=PANORAMA, turn_deg=turn, tilt=tilt)
    for row, (right, down, front) in enumerate(size.camera.rays(xy)):
        sine, cosine = np.sin(np.radians(turn)), np.cos(np.radians(turn))
        level = np.array([cosine * right + sine * front, down, cosine * front - sine * right])
        seen = ray_of_panorama(*((at[row] + 0.5) / PANORAMA), tilt)
        assert seen == pytest.approx(level / np.linalg.norm(level), abs=1e-6)
        column, line = xy[row].astype(int)
        assert (x[line, column], y[line, column]) == pytest.approx(at[row], abs=0.01)
        assert elevation[line, column] == pytest.approx(above[row], abs=1e-3)


def test_a_view_has_as_many_pixels_a_degree_as_the_panorama():
    size = view_size(PANORAMA[0], 17)
    x, _, _ = view_pixels(size, panorama=PANORAMA, turn_deg=0.0)
    middle = x[size.height // 2]
    assert np.diff(middle)[size.width // 2] == pytest.approx(1.0, abs=0.01)
    assert size.width / size.height == pytest.approx(4.0 / 3.0, abs=0.01)
    assert size.camera.fov_deg == pytest.approx(91.0, abs=0.2)
