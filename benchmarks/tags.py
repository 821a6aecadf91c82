"""How exactly printed tags place a camera, and whether the stated radius holds, in simulations.

    python -m benchmarks.tags --photos 40

Tags hang on a wall at random heights; the camera looks at them from random directions within 50 degrees.
Corners, positions, mounting and focal length are off by as much as the program expects.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.landmarks.absolute_pose import Lens
from webapp.core.tags.pose import PlacedTag, mount_rotation, solve_by_tags

WIDTH, HEIGHT, FOCAL = 1600, 1200, 1250.0
SIZE_M, CORNER_PX, POSITION_M = 0.16, 0.2, 0.01

Array = NDArray[np.float64]


def camera(heading: float, pitch: float, roll: float) -> Array:
    """Return the rotation of a camera from the frame of the map; radians."""
    level = math.cos(pitch)
    forward = np.array([math.sin(heading) * level, -math.cos(heading) * level, -math.sin(pitch)])
    right = np.array([math.cos(heading), math.sin(heading), 0.0])
    upright = np.stack([right, np.cross(forward, right), forward])
    return np.asarray(so3.exp(np.array([0.0, 0.0, roll])) @ upright)


def simulate(
    count: int, distance_m: float, *, focal_sigma: float, headings: bool, rng: np.random.Generator
) -> tuple[float, float, bool]:
    """Solve one camera; return error and radius of the place nearest to it, metres, and if it is first."""
    angle = math.radians(rng.uniform(-50.0, 50.0))
    centre = np.array([distance_m * math.sin(angle), distance_m * math.cos(angle), rng.normal(0.0, 0.3)])
    rotation = camera(-angle + rng.normal(0.0, 0.1), rng.normal(0.0, 0.08), rng.normal(0.0, 0.05))
    tags = []
    for number in range(count):
        across = rng.uniform(-0.4, 0.4) * distance_m if count > 1 else 0.0
        at = np.array([across, 0.0, rng.normal(0.0, 0.3)])
        turned = mount_rotation("wall", math.pi) @ so3.exp(np.radians(rng.normal(0.0, [2.0, 3.0, 2.0])))
        stated = at * [1.0, 1.0, 0.0] + [*rng.normal(0.0, POSITION_M, 2), 0.0]
        sigma = np.array([POSITION_M, POSITION_M, 1.0])
        tag = PlacedTag(str(number), np.zeros((4, 2)), SIZE_M, stated, sigma, "wall", math.pi)
        own = (at + tag.shape @ turned.T - centre) @ rotation.T
        pixels = FOCAL * own[:, :2] / own[:, 2:] + [(WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0]
        pixels += rng.normal(0.0, CORNER_PX, (4, 2))
        tags.append(replace(tag, corners=pixels, heading_rad=math.pi if headings else None))
    lens = Lens(WIDTH, HEIGHT, FOCAL * math.exp(rng.normal(0.0, focal_sigma)), focal_sigma=focal_sigma)
    found = solve_by_tags(tags, lens=lens)
    if isinstance(found, NoPose):
        return math.inf, 0.0, False
    off = [math.dist(pose.centre[:2], centre[:2]) for pose in found.poses]
    nearest = int(np.argmin(off))
    return off[nearest], found.poses[nearest].radius_m, nearest == 0


def main() -> None:
    """Print a row for each number of tags, distance and accuracy of the focal length."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--photos", type=int, default=40)
    photos = parser.parse_args().photos
    print("tags  headings  distance  focal  error, median  radius, median  holds  right one first")
    for count, headings in ((1, True), (2, True), (2, False), (4, True), (4, False)):
        for distance_m in (1.0, 3.0, 8.0):
            for focal_sigma in (0.01, 0.1):
                rng = np.random.default_rng(0)
                rows = [
                    simulate(count, distance_m, focal_sigma=focal_sigma, headings=headings, rng=rng)
                    for _ in range(photos)
                ]
                off, radius, first = (np.array(column) for column in zip(*rows, strict=True))
                print(
                    f"{count:4}  {'known' if headings else 'unknown':8}  {distance_m:6.0f} m  "
                    f"{100 * focal_sigma:3.0f} %  {np.median(off):11.3f} m  {np.median(radius):12.3f} m  "
                    f"{np.mean(off <= radius):5.2f}  {np.mean(first):15.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
