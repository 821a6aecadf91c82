"""Accuracies of the known positions of photos."""

import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.tasks.landmarks.known import known_positions

TENTH = Georeference("EPSG:32635", (0.1, 0.0, 470_683.0, 0.0, -0.1, 6_696_811.0, 0.0, 0.0, 1.0), "corners")
"""Metres per pixel."""


def photo(id, **known):
    return Experience(id, f"{id}.jpg", MapPixel(10.0 * id, 50.0), **known)


def test_positions_are_as_exact_as_their_origin():
    photos = (
        photo(0),
        photo(1, by_gps=True, gps_accuracy_m=3.0),
        photo(2, gps_accuracy_m=3.0, radius_px=15.15),
        photo(3, radius_px=0.1),
    )
    known = known_positions(photos, Map(SatelliteImage("s.png", 900, 900), photos, TENTH))
    assert known.sigma_px == pytest.approx([1.0, 30.0 / 1.515, 10.0, 1.0], rel=1e-2)
    assert known.derived.tolist() == [False, False, True, True]
    assert np.array_equal(known.at, [0 + 50j, 10 + 50j, 20 + 50j, 30 + 50j])
