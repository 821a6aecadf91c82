"""The area proposed for an image from the GPS of photos."""

import numpy as np
import pytest

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.tilegrid import area_around
from webapp.core.geo.types import LatLon

LUND = LatLon(55.7055, 13.1930)


def around(origin, enu):
    return LocalFrame(origin).latlon_from_enu(enu)


def street(count=30, length=200.0):
    east = np.linspace(-length / 2, length / 2, count)
    return np.column_stack([east, 5.0 * np.sin(east)])


def extent_m(box, origin):
    """Return the extent of an area from west to east and from south to north, metres."""
    corners = LocalFrame(origin).enu_from_latlon([(box.south, box.west), (box.north, box.east)])
    return (corners[1] - corners[0]).tolist()


def test_all_photos_lie_inside_with_room_around_them():
    positions = around(LUND, street())
    area = area_around(positions)
    assert (area.inside, area.outside) == (30, 0)
    lat, lon = positions.T
    assert area.box.south < lat.min() and lat.max() < area.box.north
    assert area.box.west < lon.min() and lon.max() < area.box.east
    assert extent_m(area.box, LUND) == pytest.approx([260, 70], abs=3)


def test_photos_taken_elsewhere_and_wrong_positions_do_not_stretch_it():
    wrong = [(0.0, 0.0), (48.2, 16.4), *around(LUND, [(4000.0, -2500.0)])]
    area = area_around([*around(LUND, street()), *wrong])
    assert (area.inside, area.outside) == (30, 3)
    assert area.box == pytest.approx(area_around(around(LUND, street())).box, abs=1e-5)


def test_a_long_walk_is_kept_whole():
    area = area_around(around(LUND, [*street(length=100.0), *street(count=10, length=500.0)]))
    assert area.outside == 0


def test_one_photo_has_surroundings():
    area = area_around([LUND])
    assert extent_m(area.box, LUND) == pytest.approx([60, 60], abs=0.1)


def test_it_may_lie_across_the_180th_meridian():
    taveuni = LatLon(-16.80, 180.0)
    area = area_around(around(taveuni, street()))
    assert area.box.west == pytest.approx(180.0, abs=0.01) and area.box.west > 0
    assert area.box.east == pytest.approx(-180.0, abs=0.01) and area.box.east < 0
