"""Make the picture of the page on fusion: `python -m docs.make_fusion_picture`.

A simulated drive, on which the receiver is led astray five times and knows nothing for a while.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.missions.core.simulated import Drive
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.fusion import Fusion, fuse
from webapp.missions.core.trajectory.records import Poses, Source, make_poses
from webapp.missions.render.track_picture import Shown, draw_tracks

PICTURE = Path(__file__).resolve().parent / "pictures" / "fusion.png"
FRAME = LocalFrame(LatLon(50.0755, 14.4378))


def main() -> None:
    """Simulate, fuse, and draw."""
    drive = Drive(8, nodes=620, rate=_round)
    astray = np.array([12, 31, 52, 100, 130])
    drive.measured[astray] += np.array([(25, 18), (-22, 14), (6, -32), (28, -12), (-20, -24)])
    odometry = make_poses(
        drive.steps.times_s, FRAME.latlon_from_enu(drive.reckoned()), heading_deg=np.degrees(_own(drive))
    )
    heard = (drive.node < 240) | (drive.node > 360)
    measured = FRAME.latlon_from_enu(drive.measured[heard])
    spread = np.tile([drive.sigma_m**2, drive.sigma_m**2, 0.0], (len(measured), 1))
    fixes = make_poses(drive.steps.times_s[drive.node[heard]], measured, covariance_m2=spread)
    fused = fuse(odometry, {"visual": fixes})
    assert isinstance(fused, Fusion)
    gating = fused.gating["visual"]
    gated = [
        (LatLon(*fixes.latlon[number].tolist()), LatLon(*expected.tolist()))
        for number, expected in zip(gating.number[gating.gated], gating.expected[gating.gated], strict=True)
    ]
    tracks: list[tuple[Source, Poses]] = [("odometry", odometry), ("gps", fixes), ("fused", fused.poses)]
    draw_tracks(Shown(tracks, gated, fused.begins_s)).save(PICTURE, optimize=True)


def _round(seconds: float) -> float:
    """Turn left by a quarter every seventy seconds, in ten."""
    return -np.pi / 20 if 55 <= seconds % 70 < 65 else 0.02 * np.sin(seconds / 4)


def _own(drive: Drive) -> np.ndarray:
    return np.asarray(drive.heading[0] + drive.steps.heading_rad)


if __name__ == "__main__":
    main()
