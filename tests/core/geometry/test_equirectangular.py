"""Level views of panoramas: their pixels show the directions given by the camera."""

import numpy as np
import pytest

from webapp.core.geometry.equirectangular import view_pixels, view_size

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


def test_a_view_has_as_many_pixels_a_degree_as_the_panorama():
    size = view_size(PANORAMA[0], 17)
    x, _, _ = view_pixels(size, panorama=PANORAMA, turn_deg=0.0)
    middle = x[size.height // 2]
    assert np.diff(middle)[size.width // 2] == pytest.approx(1.0, abs=0.01)
    assert size.width / size.height == pytest.approx(4.0 / 3.0, abs=0.01)
    assert size.camera.fov_deg == pytest.approx(91.0, abs=0.2)
