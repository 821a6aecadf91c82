import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geometry import so3

small = st.floats(-1.5, 1.5)


@given(small, small, small)
def test_log_undoes_exp(x, y, z):
    turn = np.array([[x, y, z]])
    rotation = so3.exp(turn)
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), np.eye(3)[None], atol=1e-12)
    np.testing.assert_allclose(so3.log(rotation), turn, atol=1e-6)


@pytest.mark.parametrize(
    ("heading_deg", "east", "north"), [(0, 0, 1), (90, 1, 0), (180, 0, -1), (270, -1, 0)]
)
def test_level_cameras_look_along_their_heading(heading_deg, east, north):
    rotation = so3.from_heading(np.array([math.radians(heading_deg)]))
    np.testing.assert_allclose(rotation[0, 2], [east, 0, north], atol=1e-12)
    np.testing.assert_allclose(rotation[0, 1], [0, 1, 0], atol=1e-12)
    assert math.isclose(
        float(so3.wrap(so3.heading(rotation) - math.radians(heading_deg))[0]), 0, abs_tol=1e-9
    )


def test_steps_are_cut_to_the_longest_allowed():
    cut = so3.clamp_norm(np.array([[3.0, 4.0], [0.3, 0.4]]), 1.0)
    np.testing.assert_allclose(cut, [[0.6, 0.8], [0.3, 0.4]])
