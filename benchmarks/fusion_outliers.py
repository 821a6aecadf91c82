"""Fuses simulated odometry with fixes that include outliers, and compares the tracks with those of GTSAM.

    pip install gtsam
    python -m benchmarks.fusion_outliers [--seeds 10] [--first-seed 100]

A car drives four kilometres of streets with loops at 8 m/s, similar to KITTI 00. Its odometry (10 Hz) drifts
by random errors, a scale error and a constant curvature; there is a fix every 10 s with a standard deviation
of 3 m on each axis. Outliers are at another point of the path, or 15 to 150 m off. Prints the median over the
seeds of the absolute position error (RMS, metres, without alignment).

GTSAM gets the true parameters of the simulation: the noise of odometry and fixes, and the start pose. Our
method gets only the standard deviation of good fixes. Seeds below 100 were used to develop the method;
figures are from others.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.fusion import Fusion, fuse
from webapp.missions.core.trajectory.records import make_poses

FRAME = LocalFrame(LatLon(50.0, 14.0))
HZ, SPEED, SECONDS = 10.0, 8.0, 470
FIX_S, SIGMA_M = 10.0, 3.0
SHARES = (0.0, 0.15, 0.25)
WAY_NOISE, SIDE_NOISE, TURN_NOISE = 0.02, 0.01, 0.002
"""Random errors of the odometry along, across and in heading: m, m, rad, each per square root of a metre."""
SCALE, CURVE = 0.01, 2e-4
"""Standard deviations of the odometry's systematic errors: scale (relative), curvature (rad per metre)."""
EVERY = 10
"""GTSAM gets a node for every so many poses, with the odometry between them."""

Pose = NDArray[np.float64]
"""(n, 3): metres east and north, heading in radians counterclockwise from east."""


@dataclass(frozen=True)
class Drive:
    """A simulated drive: ground truth, odometry, and fixes with the indices of their poses."""

    times_s: NDArray[np.float64]
    truth: Pose
    odometry: Pose
    fixes: NDArray[np.float64]
    at: NDArray[np.intp]


def simulate(seed: int, *, wrong: float) -> Drive:
    """Simulate a drive through a grid of streets, turning at random corners."""
    rng = np.random.default_rng(seed)
    n = int(SECONDS * HZ)
    step = SPEED / HZ
    turns = np.zeros(n)
    corner = 0
    while (corner := corner + int(rng.integers(60, 250))) < n - 40:
        turns[corner : corner + 30] += rng.choice([-1, 1]) * np.pi / 2 / 30
    truth = _driven(np.full(n, step), np.zeros(n), turns)
    scale, curve = 1 + rng.normal(0, SCALE), rng.normal(0, CURVE)
    root = step**0.5
    forward = scale * (step + rng.normal(0, WAY_NOISE * root, n))
    side = rng.normal(0, SIDE_NOISE * root, n)
    odometry = _driven(forward, side, turns + curve * step + rng.normal(0, TURN_NOISE * root, n))
    at = np.arange(0, n, int(FIX_S * HZ))
    fixes = truth[at, :2] + rng.normal(0, SIGMA_M, (len(at), 2))
    bad = rng.permutation(len(at))[: round(wrong * len(at))]
    for place, fix in enumerate(bad):
        if place % 2:
            fixes[fix] = truth[rng.integers(n), :2]
        else:
            angle = rng.uniform(-np.pi, np.pi)
            fixes[fix] += rng.uniform(15, 150) * np.array([np.cos(angle), np.sin(angle)])
    return Drive(np.arange(n) / HZ, truth, odometry, fixes, at)


def _driven(forward: NDArray[np.float64], side: NDArray[np.float64], turn: NDArray[np.float64]) -> Pose:
    heading = np.concatenate([[0.0], np.cumsum(turn[1:])])
    before = heading[:-1]
    east = forward[1:] * np.cos(before) - side[1:] * np.sin(before)
    north = forward[1:] * np.sin(before) + side[1:] * np.cos(before)
    places = np.vstack([np.zeros((1, 2)), np.cumsum(np.column_stack([east, north]), axis=0)])
    return np.column_stack([places, heading])


def ours(drive: Drive, source: str) -> NDArray[np.float64]:
    """Fuse as for missions; return the positions at the times of the odometry."""
    heading = (90.0 - np.degrees(drive.odometry[:, 2])) % 360.0
    odometry = make_poses(drive.times_s, FRAME.latlon_from_enu(drive.odometry[:, :2]), heading_deg=heading)
    count = len(drive.at)
    covariance = np.tile([SIGMA_M**2, SIGMA_M**2, 0.0], (count, 1))
    latlon = FRAME.latlon_from_enu(drive.fixes)
    fixes = make_poses(drive.times_s[drive.at], latlon, covariance_m2=covariance)
    found = fuse(odometry, {source: fixes})  # type: ignore[dict-item]
    assert isinstance(found, Fusion)
    places = np.searchsorted(found.poses.times_s, drive.times_s)
    return FRAME.enu_from_latlon(found.poses.latlon[places])


def by_gtsam(drive: Drive, kind: str) -> NDArray[np.float64]:
    """Solve the pose graph with GTSAM; `kind` is plain, cauchy or gnc."""
    import gtsam

    nodes = np.arange(0, len(drive.times_s), EVERY)
    graph, first = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = [gtsam.Pose2(*drive.odometry[i].tolist()) for i in nodes]
    way = SPEED / HZ * EVERY
    lever = (TURN_NOISE**2 * way**3 / 3 + (CURVE * way**2 / 2) ** 2) ** 0.5
    sigmas = np.array(
        [
            np.hypot(WAY_NOISE * way**0.5, SCALE * way),
            np.hypot(SIDE_NOISE * way**0.5, lever),
            np.hypot(TURN_NOISE * way**0.5, CURVE * way),
        ]
    )
    moved = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    begin = gtsam.noiseModel.Diagonal.Sigmas(np.array([1.0, 1.0, 0.05]))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(0, 0, 0), begin))
    for i, pose in enumerate(poses):
        first.insert(i, pose)
        if i:
            graph.add(gtsam.BetweenFactorPose2(i - 1, i, poses[i - 1].between(pose), moved))
    known = graph.size()
    fixed = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA_M)
    if kind == "cauchy":
        fixed = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), fixed)
    for at, place in zip(drive.at, drive.fixes, strict=True):
        pose = gtsam.Pose2(place[0], place[1], 0.0)
        graph.add(gtsam.PoseTranslationPrior2D(int(at) // EVERY, pose, fixed))
    if kind == "gnc":
        parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
        parameters.setLossType(gtsam.GncLossType.TLS)
        parameters.setKnownInliers(list(range(known)))
        solved = gtsam.GncLMOptimizer(graph, first, parameters).optimize()
    else:
        solved = gtsam.LevenbergMarquardtOptimizer(graph, first).optimize()
    places = np.array([[solved.atPose2(i).x(), solved.atPose2(i).y()] for i in range(len(nodes))])
    return np.column_stack([np.interp(drive.times_s, nodes / HZ, axis) for axis in places.T])


def _error(found: NDArray[np.float64], drive: Drive) -> float:
    last = int(drive.times_s[-1] * HZ) // EVERY * EVERY
    return float(np.sqrt(((found - drive.truth[:, :2]) ** 2).sum(axis=1)[: last + 1].mean()))


METHODS: dict[str, Callable[[Drive], NDArray[np.float64]]] = {
    "ours, GPS": lambda drive: ours(drive, "gps"),
    "ours, visual fixes": lambda drive: ours(drive, "visual"),
    "GTSAM": lambda drive: by_gtsam(drive, "plain"),
    "GTSAM, Cauchy": lambda drive: by_gtsam(drive, "cauchy"),
    "GTSAM, GNC": lambda drive: by_gtsam(drive, "gnc"),
}


def main() -> None:
    """Print the median and the worst errors over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--only", default="", help="Methods whose names begin so.")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print("| method | " + " | ".join(f"{share:.0%} wrong" for share in SHARES) + " | seconds |")
    print("|---|" + "---:|" * (len(SHARES) + 1))
    for name, method in METHODS.items():
        if not name.startswith(arguments.only):
            continue
        begun = time.perf_counter()
        cells = []
        for share in SHARES:
            drives = [simulate(seed, wrong=share) for seed in seeds]
            errors = [_error(method(drive), drive) for drive in drives]
            cells.append(f"{median(errors):.2f} (worst {max(errors):.1f})")
        seconds = (time.perf_counter() - begun) / len(SHARES) / len(seeds)
        print(f"| {name} | " + " | ".join(cells) + f" | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
