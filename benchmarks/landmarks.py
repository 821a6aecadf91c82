"""Measures accuracy and time of localizing a photo in a simulated cloud of landmarks.

    python -m benchmarks.landmarks --points 40000 [--focal-sigma 0.1]

The scene is a yard of 100 m x 50 m full of points; each map photo recognises a third of the points that it
sees. A query is a camera near one of the map photos: half of its keypoints show no landmark, descriptors have
noise, and keypoints have noise of half a pixel. Prints one JSON object: errors of the cameras, and
milliseconds of the stage from descriptors to the camera, given 20 retrieved photos: wall time, and CPU time
on one core. With --focal-sigma the focal length of queries is stated with errors of this standard deviation
(as a fraction), and the figures are printed twice: where it is taken as exact, and where it is refined;
`held` is the share of positions within their stated 68 % radius.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import faiss
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.landmarks.absolute_pose import AbsolutePose, Lens, project, solve_camera
from webapp.core.landmarks.cloud import AlignedCloud, LandmarkCloud
from webapp.core.landmarks.submodels import Submodel

Array = NDArray[np.float64]

LENS = Lens(800, 600, 640.0, 0.01)
LENGTH, WIDTH, FAR = 100.0, 50.0, 30.0
"""Length and width of the yard, and range within which landmarks are recognised, metres."""

_KEYPOINTS, _WRONG, _NOISE_PX, _NOISE = 1000, 0.5, 0.5, 12.0
"""Of a query: number of keypoints, share without a landmark, noise of keypoints and of descriptors."""

_RETRIEVED = 20
_RADIUS_OVER_SIGMAS = 1.07
"""68 % radius over the root of the sum of both variances."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A cloud, the cameras that saw it, and the descriptor of each point (k, 128)."""

    aligned: AlignedCloud
    centre: Array
    rotation: Array
    look: NDArray[np.uint8]


def level_camera(heading: float) -> Array:
    """Return the camera-from-world rotation of a level camera; the world is x right, y ahead, z up."""
    sine, cosine = np.sin(heading), np.cos(heading)
    return np.array([[cosine, -sine, 0.0], [0.0, 0.0, -1.0], [sine, cosine, 0.0]])


def make_scene(points: int, *, photos: int, rng: np.random.Generator) -> Scene:
    """Make a yard with points, and photos that observe them."""
    at = np.column_stack(
        [rng.uniform(0, LENGTH, points), rng.uniform(0, WIDTH, points), rng.uniform(0, 8, points)]
    )
    centre = np.column_stack(
        [rng.uniform(5, LENGTH - 5, photos), rng.uniform(5, WIDTH - 5, photos), np.full(photos, 1.6)]
    )
    rotation = np.stack([level_camera(heading) for heading in rng.uniform(0, 2 * np.pi, photos)])
    look = rng.integers(0, 120, (points, 128), dtype=np.uint8)
    point, xy = [], []
    for number in range(photos):
        seen, there = visible(at, rotation=rotation[number], centre=centre[number])
        some = np.sort(rng.permutation(len(seen))[: len(seen) // 3])
        point.append(seen[some])
        xy.append(there[some])
    first = np.cumsum([0, *map(len, point)])
    rows = np.concatenate(point)
    cloud = LandmarkCloud(
        tuple(map(str, range(photos))),
        at,
        np.zeros(points, np.int32),
        first,
        rows.astype(np.int32),
        np.concatenate(xy).astype(np.float32),
        noisy(look[rows], rng),
        np.full(photos, LENS.focal_px),
        np.full(photos, LENS.distortion),
    )
    aligned = AlignedCloud(cloud, "", np.arange(photos), (Submodel(np.arange(photos), centre, rotation),), ())
    return Scene(aligned, centre, rotation, look)


def visible(at: Array, *, rotation: Array, centre: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the points that a camera sees, at most `_KEYPOINTS`, and their pixels."""
    own = (at - centre) @ rotation.T
    near = np.flatnonzero((own[:, 2] > 1.0) & (own[:, 2] < FAR))
    xy = project(at[near], lens=LENS, rotation=rotation, centre=centre)
    inside = ((xy >= 0.0) & (xy <= [LENS.width - 1, LENS.height - 1])).all(1)
    return near[inside][:_KEYPOINTS], xy[inside][:_KEYPOINTS]


def noisy(descriptors: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add noise to descriptors."""
    return np.clip(descriptors + rng.normal(0.0, _NOISE, descriptors.shape), 0, 255).astype(np.uint8)


def make_query(scene: Scene, rng: np.random.Generator) -> tuple[Features, Array, Array]:
    """Simulate a photo near one of the scene's; return it, and its camera's true centre and rotation."""
    beside = rng.integers(len(scene.centre))
    centre = scene.centre[beside] + rng.normal(0.0, 1.0, 3) * [1.0, 1.0, 0.2]
    rotation = so3.exp(rng.normal(0.0, 0.1, 3)) @ scene.rotation[beside]
    seen, xy = visible(scene.aligned.cloud.point, rotation=rotation, centre=centre)
    some = rng.permutation(len(seen))[: int(_KEYPOINTS * (1.0 - _WRONG))]
    wrong = _KEYPOINTS - len(some)
    where = np.concatenate(
        [
            xy[some] + rng.normal(0.0, _NOISE_PX, (len(some), 2)),
            rng.uniform(0.0, [LENS.width, LENS.height], (wrong, 2)),
        ]
    )
    look = np.concatenate(
        [noisy(scene.look[seen[some]], rng), rng.integers(0, 120, (wrong, 128), dtype=np.uint8)]
    )
    angle = np.zeros(len(where), np.float32)
    features = Features(where.astype(np.float32), angle, angle, look, (LENS.width, LENS.height))
    return features, centre, rotation


def localize(
    scene: Scene, query: Features, near: Array, *, lens: Lens = LENS
) -> tuple[float, AbsolutePose | None]:
    """Solve a query's camera, with the photos nearest to a point as retrieved; return seconds and pose."""
    apart = np.linalg.norm(scene.centre - near, axis=1)
    started = time.perf_counter()
    groups = scene.aligned.groups(
        np.argsort(apart)[:_RETRIEVED], visible=np.ones(len(apart), np.bool_), most=4
    )
    solved = [solve_camera(query, scene.aligned.cloud, rows=g.rows, lenses=[lens]).pose for g in groups]
    seconds = time.perf_counter() - started
    poses = [pose for pose in solved if not isinstance(pose, NoPose)]
    return seconds, max(poses, key=lambda pose: pose.score, default=None)


@contextmanager
def one_thread() -> Iterator[None]:
    """Make Faiss use one thread, since threads that wait for each other count as CPU time."""
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(before)


def measure(
    points: int, *, photos: int, queries: int, seed: int = 1, focal_sigma: float = 0.0, refines: bool = False
) -> dict[str, float]:
    """Localize queries in a scene; return the figures.

    Args:
        focal_sigma: Standard deviation of the error of the stated focal lengths, as a fraction.
        refines: Whether the focal length is estimated, or taken as stated.
    """
    rng = np.random.default_rng(seed)
    scene = make_scene(points, photos=photos, rng=rng)
    metres, degrees, held, seconds, cpu = [], [], [], [], []
    for _ in range(queries):
        query, centre, rotation = make_query(scene, rng)
        stated = LENS.focal_px * float(np.exp(rng.normal(0.0, focal_sigma)))
        lens = replace(LENS, focal_px=stated, focal_sigma=focal_sigma if refines else 0.0)
        with one_thread():
            before = time.process_time()
            localize(scene, query, centre, lens=lens)
            cpu.append(time.process_time() - before)
        took, pose = localize(scene, query, centre, lens=lens)
        seconds.append(took)
        if pose is not None:
            off = pose.centre - centre
            metres.append(float(np.linalg.norm(off)))
            degrees.append(float(np.degrees(np.linalg.norm(so3.log(pose.rotation @ rotation.T)))))
            held.append(
                np.hypot(off[0], off[1]) <= _RADIUS_OVER_SIGMAS * np.sqrt(np.trace(pose.covariance[:2, :2]))
            )
    return {
        "points": points,
        "observations": len(scene.aligned.cloud.seen_point),
        "queries": queries,
        "solved": len(metres),
        "median_m": round(float(np.median(metres)), 4),
        "worst_m": round(max(metres), 4),
        "held": round(float(np.mean(held)), 2),
        "median_deg": round(float(np.median(degrees)), 4),
        "median_ms_of_one_core": round(1000.0 * float(np.median(cpu)), 1),
        "median_ms": round(1000.0 * float(np.median(seconds)), 1),
        "p95_ms": round(1000.0 * float(np.quantile(seconds, 0.95)), 1),
    }


def main() -> None:
    """Measure with the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=40_000)
    parser.add_argument("--photos", type=int, default=600)
    parser.add_argument("--queries", type=int, default=50)
    parser.add_argument("--focal-sigma", type=float, default=0.0)
    given = parser.parse_args()
    sizes = {"photos": given.photos, "queries": given.queries, "focal_sigma": given.focal_sigma}
    for refines in (False, True) if given.focal_sigma else (False,):
        print(json.dumps(measure(given.points, **sizes, refines=refines), indent=1))


if __name__ == "__main__":
    main()
