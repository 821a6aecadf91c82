"""Missions to export."""

import numpy as np
import pytest

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import make_poses

HOSTILE = "<b>&amp ]]><![CDATA[ \"'\x07"


@pytest.fixture
def poses():
    """Make poses every half a second; some have no heading, height or covariance."""

    def make(n, *, seed=0, whole=False):
        rng = np.random.default_rng(seed)
        latlon = np.column_stack([50 + rng.normal(0, 1e-3, n), 14 + rng.normal(0, 1e-3, n)])
        height, heading = rng.normal(200, 3, n), rng.uniform(0, 360, n)
        covariance = np.column_stack([rng.uniform(1, 2, n), rng.uniform(1, 2, n), rng.normal(0, 0.1, n)])
        if not whole:
            height[::3] = heading[1::3] = np.nan
            covariance[::2] = np.nan
        times = 1.7e9 + 0.5 * np.arange(n) + 0.015625
        more = {"height_m": height, "heading_deg": heading, "covariance_m2": covariance}
        return make_poses(times, latlon, travelled_m=np.arange(n) * 0.25, **more)

    return make


@pytest.fixture
def track():
    """Make a track of poses that are read in parts of a size."""

    def make(poses, *, id=1, source="gps", name="", size=7):
        def parts():
            for first in range(0, len(poses), size):
                yield poses.take(slice(first, first + size))

        (south, west), (north, east) = poses.latlon.min(0), poses.latlon.max(0)
        bounds = (south, west, north, east)
        return ExportTrack(id, source, name, len(poses), 0.25 * len(poses), bounds, parts)

    return make


@pytest.fixture
def mission(poses, track):
    """A mission of three tracks and three objects, with hostile names."""
    tracks = (
        track(poses(20), id=1),
        track(poses(9, seed=1, whole=True), id=2, source="odometry", name=HOSTILE),
        track(poses(1, seed=2), id=3, source="manual"),
    )
    objects = [
        ExportObject(
            "car-1",
            "car",
            LatLon(50.001, 14.002),
            1.7e9,
            1.7e9 + 5,
            201.5,
            0.75,
            2,
            "ab" * 32,
            (4.0, 9.0, 1.5),
            (4.5, 1.75, 1.5),
        ),
        ExportObject(HOSTILE, HOSTILE, LatLon(-50.5, -170.25), 1.7e9, 1.7e9, None, None, 1, None),
        ExportObject("v", "victim", LatLon(50.003, 14.004), 1.7e9 + 1, 1.7e9 + 9, None, 1.0, 3, None),
    ]
    kinds = ("car", HOSTILE, "victim")
    return MissionExport(f"Search {HOSTILE}", tracks, kinds, lambda: iter(objects))
