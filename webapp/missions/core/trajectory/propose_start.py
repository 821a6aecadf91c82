"""The start of a robot, proposed from positions on the Earth that were recorded at the same times."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.robotframe import Start

_REACH_M = 150.0
"""Only this much of the way is used: odometry drifts."""

_LEAST_PAIRS, _LEAST_SPAN_M = 5, 3.0
_SPAN_OF_ERRORS = 4.0
"""How many times as far the robot went as its positions scatter: otherwise the heading is a guess."""

_GAP_S = 5.0
"""Maximum time between a pose and the nearest position."""

_ROUNDS = 4

Floats = NDArray[np.float64]


def propose_start(times_s: Floats, ahead_m: Floats, *, fix_times_s: Floats, fixes: Floats) -> Start | None:
    """Align a robot's way with positions on the Earth, and return where it started; None if that is unclear.

    Args:
        times_s: (n,) times of the poses.
        ahead_m: (n, 2) metres forward and left of the first pose.
        fix_times_s: (m,) times of the positions.
        fixes: (m, 2) latitude and longitude.
    """
    if len(times_s) < _LEAST_PAIRS or len(fixes) < 2:
        return None
    order = np.argsort(fix_times_s, kind="stable")
    fix_times_s, fixes = fix_times_s[order], fixes[order]
    frame = LocalFrame(LatLon(*fixes[0].tolist()))
    enu = frame.enu_from_latlon(fixes)
    steps = np.hypot(*np.diff(ahead_m, axis=0, prepend=ahead_m[:1]).T)
    used = (np.cumsum(steps) <= _REACH_M) & _is_near(times_s, fix_times_s)
    way = ahead_m[used]
    there = np.column_stack([np.interp(times_s[used], fix_times_s, enu[:, axis]) for axis in (0, 1)])
    keep = np.ones(len(way), dtype=bool)
    for _ in range(_ROUNDS):
        if keep.sum() < _LEAST_PAIRS:
            return None
        turn, shift = _rigid(way[keep], there[keep])
        errors = np.hypot(*(way @ turn.T + shift - there).T)
        keep = errors <= 3.0 * max(float(np.median(errors[keep])), 0.05)
    scatter = math.sqrt(float(np.mean(errors[keep] ** 2)))
    span = float(np.hypot(*np.ptp(way[keep], axis=0)))
    if span < max(_LEAST_SPAN_M, _SPAN_OF_ERRORS * scatter):
        return None
    east, north = turn[:, 0].tolist()
    lat, lon = frame.latlon_from_enu(shift[None])[0].tolist()
    return Start(LatLon(lat, lon), math.degrees(math.atan2(east, north)) % 360.0)


def _is_near(times_s: Floats, others: Floats) -> NDArray[np.bool_]:
    """Return for each time whether another one is near, on both sides of it or at the same time."""
    after = np.searchsorted(others, times_s).clip(0, len(others) - 1)
    before = (after - 1).clip(0)
    nearest = np.minimum(abs(others[after] - times_s), abs(others[before] - times_s))
    near: NDArray[np.bool_] = (
        (nearest <= _GAP_S) & (times_s >= others[0] - 1.0) & (times_s <= others[-1] + 1.0)
    )
    return near


def _rigid(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return rotation (2, 2) and shift (2,) from one list of positions to another (Kabsch, 1976)."""
    mid, other = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mid, target - other
    angle = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    sin, cos = math.sin(angle), math.cos(angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    return turn, other - turn @ mid
