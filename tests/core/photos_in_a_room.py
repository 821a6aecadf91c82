"""Photos of random points with known camera poses, as pairs and views."""

import math

import numpy as np

from webapp.core.geometry import so3
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.localize.pose_refinement import VerifiedView
from webapp.core.reconstruction.pairs import PhotoPairs, concatenate

RADIUS = 50.0
RAY_SIGMA = 2.0 / 450.0


def tilted(heading, pitch=0.0):
    """Return the camera-from-world rotation of a camera pitched up by `pitch`."""
    c, s = math.cos(pitch), math.sin(pitch)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ so3.from_heading(np.array(heading))


class Scene:
    """Points on a ring of walls around the map's middle, and level or pitched cameras that see them."""

    def __init__(self, seed=0, points=4000):
        self.rng = np.random.default_rng(seed)
        angle, far = self.rng.uniform(0, 2 * np.pi, points), self.rng.uniform(120, 320, points)
        height = self.rng.uniform(-80, 40, points)
        self.points = np.column_stack([far * np.sin(angle), height, far * np.cos(angle)])

    def rays(self, rotation, position):
        """Return the rays (n, 2) of all points, and which are in the picture."""
        world = np.array([position[0], 0.0, -position[1]])
        at = (self.points - world) @ rotation.T
        ray = at[:, :2] / np.where(at[:, 2:] == 0.0, 1e-9, at[:, 2:])
        return ray, (at[:, 2] > 1.0) & (np.abs(ray) < 0.75).all(1)

    def seen_by_both(self, one, two, most=80, noise=0.0):
        """Return the indices (m,) of points in both pictures, and their rays (m, 2) in each."""
        a, in_a = self.rays(*one)
        b, in_b = self.rays(*two)
        both = np.flatnonzero(in_a & in_b)
        both = self.rng.permutation(both)[:most]
        return both, *(x[both] + self.rng.normal(0, noise, (len(both), 2)) for x in (a, b))

    def inverse_depths(self, camera, points):
        """Return the inverse depths of points."""
        world = np.array([camera[1][0], 0.0, -camera[1][1]])
        return 1.0 / ((self.points[points] - world) @ camera[0][2])

    def relative(self, one, two):
        """Return the rotation and unit translation of camera two relative to camera one."""
        rotation = two[0] @ one[0].T
        gap = np.array([one[1][0] - two[1][0], 0.0, -(one[1][1] - two[1][1])])
        return rotation, two[0] @ gap / np.linalg.norm(gap)

    def pair(self, number, cameras, noise=0.001):
        i, j = number
        points, ours, theirs = self.seen_by_both(cameras[i], cameras[j], noise=noise)
        if len(ours) < 15:
            return None
        rotation, shift = self.relative(cameras[i], cameras[j])
        shaken = so3.exp(self.rng.normal(0, 0.03, 3))
        return PhotoPairs(
            first=np.array([i]),
            second=np.array([j]),
            rotation=(shaken @ rotation)[None],
            translation=(shaken @ shift)[None],
            trust=np.array([0.8]),
            parallax=np.array([0.1]),
            start=np.array([0, len(ours)]),
            row_first=points.astype(np.int32),
            row_second=points.astype(np.int32),
            ray_first=ours.astype(np.float32),
            ray_second=theirs.astype(np.float32),
        )

    def pairs(self, cameras):
        numbers = [(i, j) for i in range(len(cameras)) for j in range(len(cameras)) if i != j]
        return concatenate([p for n in numbers if (p := self.pair(n, cameras)) is not None])

    def view(self, photo, camera, query, noise=0.001, depths=False):
        """Return the matches of a photo with a query; with depths, those of every second match are known."""
        points, ours, theirs = self.seen_by_both(query, camera, noise=noise)
        inverse = np.full(len(points), np.nan)
        if depths:
            inverse[::2] = self.inverse_depths(camera, points[::2])
        rotation, shift = self.relative(query, camera)
        shaken = so3.exp(self.rng.normal(0, 0.03, 3))
        inlier = np.ones(len(ours), bool)
        pose = RelativePose(0.0, 0.1, inlier, shaken @ rotation, shaken @ shift)
        return VerifiedView(
            photo, pose, deep(ours), deep(theirs), inverse, 0.05 * inverse, (RAY_SIGMA, RAY_SIGMA)
        )


def deep(ray):
    return np.column_stack([ray, np.ones(len(ray))])


def cameras(scene, count, seed=1):
    rng = np.random.default_rng(seed)
    return [
        (tilted(rng.uniform(0, 2 * np.pi), rng.normal(0, 0.08)), rng.uniform(-60, 60, 2))
        for _ in range(count)
    ]
