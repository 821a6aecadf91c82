"""Known heights as priors of an adjustment."""

from types import SimpleNamespace

import numpy as np
import pytest

from webapp.core.landmarks.heights import Altitude, Altitudes
from webapp.core.landmarks.submodels import Submodel
from webapp.files.landmarks.position_priors import PicturePositions, PositionPriors, _Photos


@pytest.mark.parametrize(
    ("joined_m", "spread"),
    [([40.0] * 8, 0.0), ([40.0, 60.0] * 4, 20.0 / 2 / 1.5), ([None] * 8, 0.0)],
    ids=["one height", "two heights", "no altitudes"],
)
def test_only_photos_in_the_model_say_whether_heights_fix_the_focal_length(joined_m, spread):
    """Here the flight has two more photos, from higher up, that could not be joined."""
    above_m = [*joined_m, 140.0, 140.0]
    altitudes = Altitudes(tuple(Altitude(above_start_m=one) for one in above_m), 10.0)
    names = tuple(f"{n}" for n in range(10))
    nothing = np.zeros(0)
    numbers = np.arange(10)
    positions = PicturePositions(
        names, numbers, 0 * numbers, (), np.zeros((0, 2)), nothing, 1e3, (), altitudes.heights(usual_px=1e3)
    )
    priors = PositionPriors.__new__(PositionPriors)
    priors._positions, priors._row = positions, {name: row for row, name in enumerate(names)}
    images = {n: SimpleNamespace(name=names[n], image_id=100 + n) for n in range(8)}
    found = priors._height_sigmas(
        _Photos(Submodel(numbers[:8], np.zeros((8, 3)), np.zeros((8, 3, 3))), images)
    )
    values = np.array([found.get(100 + n, 0.0) for n in range(8)])
    assert np.sqrt(np.mean(values**2)) == pytest.approx(spread, rel=0.01, abs=1e-9)
