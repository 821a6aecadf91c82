"""The start of a robot, from positions on the Earth of the same time."""

import numpy as np
import pytest

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.propose_start import propose_start
from webapp.missions.core.trajectory.robotframe import RobotFrame, Start

TRUE = Start(LatLon(50.1, 14.4), 200.0)


def way(count=120, *, metres=1.0):
    """Times and positions of a robot that goes ahead, and then to the left."""
    steps = np.zeros((count, 2))
    steps[: count // 2, 0] = steps[count // 2 :, 1] = metres
    ahead = np.cumsum(steps, axis=0) - steps[0]
    return 1e9 + 0.5 * np.arange(count), ahead


def fixes_of(times_s, ahead, *, noise_m=0.0, every=2):
    """Positions by GPS, not at the times of the poses."""
    at = times_s[::every] + 0.1
    xy = np.column_stack([np.interp(at, times_s, ahead[:, axis]) for axis in (0, 1)])
    latlon = RobotFrame(TRUE).latlon_from_xy(xy)
    frame = LocalFrame(TRUE.position)
    noise = np.random.default_rng(3).normal(0.0, noise_m, (len(at), 2)) if noise_m else 0.0
    return at, frame.latlon_from_enu(frame.enu_from_latlon(latlon) + noise)


def off_m(found):
    """Distance of a start from the true one."""
    return float(np.hypot(*LocalFrame(TRUE.position).enu_of(found.position)[:2]))


@pytest.mark.parametrize(("noise_m", "within_m", "within_deg"), [(0.0, 0.2, 0.5), (1.5, 1.5, 3.0)])
def test_the_start_is_found(noise_m, within_m, within_deg):
    times_s, ahead = way()
    at, fixes = fixes_of(times_s, ahead, noise_m=noise_m)
    fixes[5] += 0.01  # an outlier
    found = propose_start(times_s, ahead, fix_times_s=at, fixes=fixes)
    assert off_m(found) < within_m
    assert abs((found.heading_deg - TRUE.heading_deg + 180) % 360 - 180) < within_deg


def test_nothing_is_proposed_where_it_would_be_a_guess():
    times_s, ahead = way()
    at, fixes = fixes_of(times_s, ahead)
    assert propose_start(times_s, ahead, fix_times_s=at + 3600, fixes=fixes) is None, "another hour"
    times_s, ahead = way(metres=0.02)
    at, fixes = fixes_of(times_s, ahead, noise_m=1.5)
    assert propose_start(times_s, ahead, fix_times_s=at, fixes=fixes) is None, "it hardly moved"
    assert propose_start(times_s[:3], ahead[:3], fix_times_s=at, fixes=fixes) is None
