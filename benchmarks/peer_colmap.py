"""Localizes with COLMAP, as hloc does: retrieval, a 3D model of the map's photos, pose from 2D-3D matches.

    python -m benchmarks.peer_colmap MAP.cfg QUERIES.csv [--limit N] [--neighbours 20] [--keypoints 2000]

Everything except the retrieval is pycolmap (extra `sfm`): SIFT, matches verified by two-view geometry, global
structure from motion (GLOMAP), absolute pose by RANSAC. Retrieval is VLAD (Jégou et al. 2010) of these SIFT
descriptors, where hloc (Sarlin et al. 2019) uses a learned vector. A pose in the model is transformed to map
pixels by a similarity in the plane of the cameras, fitted to the placed photos nearest to it in the model. A
query without a pose gets the position of the best retrieved photo. Prints one JSON object with the keys of
`expmap evaluate`.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from benchmarks.derived_maps import read
from webapp.core.hypotheses.places import place_radius_px

Array = NDArray[np.float64]

MAX_SIDE = 800
WORDS, TRAINED_ON = 64, 100_000
NEAR = 30
"""Number of photos of the model from which the position of a pose on the map is computed."""

_FEWEST_INLIERS = 12
_ROUNDS = 10


@dataclass(frozen=True, slots=True)
class Workspace:
    """Folders and options for COLMAP: names of photos are relative to `root`; `folder` is for its files."""

    root: Path
    folder: Path
    neighbours: int
    keypoints: int

    @property
    def database(self) -> Path:
        """Database with features and matches of all photos."""
        return self.folder / "database.db"


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A reconstruction, and the map positions of its photos.

    Attributes:
    ----------
    plane : (2, 3) float64
        Two axes perpendicular to the cameras' mean up direction.
    name : list of str
        Names of its n photos.
    centre : (n, 2) float64
        Camera centres, along the axes.
    position : (n, 2) float64
        Positions on the map, pixels.
    """

    found: pycolmap.Reconstruction
    plane: Array
    name: list[str]
    centre: Array
    position: Array


def main() -> None:
    """Measure and print one JSON object."""
    arguments = _arguments()
    root = arguments.map.parent
    table = read(root)
    chosen = _spread(len(table.queries), arguments.limit)
    photos = [str(p.relative_to(root)) for p in table.photos]
    queries = [str(table.queries[n].relative_to(root)) for n in chosen]
    with tempfile.TemporaryDirectory() as folder:
        work = Workspace(root, Path(folder), arguments.neighbours, arguments.keypoints)
        printed = _measure(work, dict(zip(photos, table.position, strict=True)), queries)
    width, height = table.size
    printed["place_radius_px"] = place_radius_px(table.position, width=width, height=height)
    for query, truth in zip(printed["per_query"], table.truth[chosen], strict=True):
        query["error_px"] = math.dist(query.pop("position"), truth)
    errors = np.array([q["error_px"] for q in printed["per_query"]])
    printed["median_px"] = float(np.median(errors))
    print(json.dumps(printed))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path, help="map.cfg of a folder")
    parser.add_argument("queries", type=Path, help="queries.csv of the same folder")
    parser.add_argument("--limit", type=int, default=0)
    parser.add_argument("--neighbours", type=int, default=20, help="photos that each one is matched with")
    parser.add_argument("--keypoints", type=int, default=2000)
    return parser.parse_args()


def _spread(count: int, limit: int) -> list[int]:
    most = min(limit or count, count)
    return [n * count // most for n in range(most)]


def _measure(work: Workspace, position: dict[str, Array], queries: list[str]) -> dict[str, Any]:
    """Build a model of the placed photos and localize the queries."""
    photos = [*position]
    started = time.perf_counter()
    _extract(work, photos)
    vlad, words = _describe(work.database, photos)
    near = [_nearest(vector, vlad, work.neighbours + 1) for vector in vlad]
    _match(work, ((photos[n], photos[m]) for n, others in enumerate(near) for m in others))
    models = _reconstruct(work, position)
    built = time.perf_counter() - started

    _extract(work, queries)
    asked = time.perf_counter()
    answers = []
    for name in queries:
        vector = _vlad(_sift(work.database, name), words)
        retrieved = [photos[m] for m in _nearest(vector, vlad, work.neighbours)]
        _match(work, ((name, other) for other in retrieved))
        at = _locate(work.database, name, retrieved, models=models)
        placed = position[retrieved[0]].tolist() if at is None else at
        answers.append({"position": placed, "posed": at is not None})
    return {
        "method": "pycolmap",
        "features": "sift",
        "queries": len(answers),
        "posed": sum(a["posed"] for a in answers),
        "registered": sum(len(m.name) for m in models),
        "models": len(models),
        "per_query": answers,
        "build_seconds": built,
        "seconds_per_query_p50": (time.perf_counter() - asked) / max(len(answers), 1),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def _extract(work: Workspace, names: Sequence[str]) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = MAX_SIDE
    options.sift.max_num_features = work.keypoints
    # COLMAP skips photos whose size differs from that of their shared camera
    sizes = {(Path(name).parent, Image.open(work.root / name).size) for name in names}
    shared = len(sizes) == len({folder for folder, _ in sizes})
    mode = pycolmap.CameraMode.PER_FOLDER if shared else pycolmap.CameraMode.PER_IMAGE
    pycolmap.extract_features(work.database, work.root, names, camera_mode=mode, extraction_options=options)


def _sift(database: Path, name: str) -> NDArray[np.float32]:
    """Read the descriptors of a photo as RootSIFT; empty if COLMAP skipped the photo."""
    with pycolmap.Database.open(database) as opened:
        image = opened.read_image_with_name(name)
        if image is None:
            return np.empty((0, 128), np.float32)
        stored = opened.read_descriptors(image.image_id)
    rows = np.asarray(stored.data, np.float32)
    return np.sqrt(rows / np.maximum(rows.sum(1, keepdims=True), 1.0))


def _describe(database: Path, names: Sequence[str]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Train the visual words on the map's photos; return the photos' vectors and the words."""
    described = [_sift(database, name) for name in names]
    rows = np.concatenate(described)
    rows = np.random.default_rng(0).permutation(rows)[:TRAINED_ON]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-3)
    cv2.setRNGSeed(0)
    words = cv2.kmeans(rows, WORDS, None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]
    return np.array([_vlad(d, words) for d in described]), words


def _vlad(rows: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the VLAD vector: residuals summed per word, normalised per word and as a whole."""
    sums = np.zeros_like(words)
    if len(rows):
        nearest = (rows @ words.T - (words**2).sum(1) / 2.0).argmax(1)
        np.add.at(sums, nearest, rows - words[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    vector = sums.ravel()
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


def _nearest(vector: NDArray[np.float32], among: NDArray[np.float32], most: int) -> list[int]:
    return [int(n) for n in np.argsort(-(among @ vector), kind="stable")[:most]]


def _match(work: Workspace, pairs: Iterable[tuple[str, str]]) -> None:
    file = work.folder / "pairs.txt"
    wanted = {tuple(sorted(pair)) for pair in pairs if pair[0] != pair[1]}
    file.write_text("\n".join(f"{first} {second}" for first, second in sorted(wanted)), "utf-8")
    options = pycolmap.ImportedPairingOptions()
    options.match_list_path = file
    pycolmap.match_image_pairs(work.database, pairing_options=options)


def _reconstruct(work: Workspace, position: dict[str, Array]) -> list[Model]:
    found = pycolmap.global_mapping(work.database, work.root, work.folder).values()
    return [_model(one, position) for one in found if one.num_reg_images() > 2]


def _model(found: pycolmap.Reconstruction, position: dict[str, Array]) -> Model:
    images = [image for image in found.images.values() if image.has_pose]
    up = -np.mean([image.cam_from_world().rotation.matrix()[1] for image in images], axis=0)
    plane = np.linalg.svd(up[None])[2][1:]
    if np.linalg.det(np.vstack([plane, up])) < 0.0:
        plane = plane[::-1]
    centre = np.array([image.projection_center() for image in images]) @ plane.T
    # y of map pixels points down, so the second axis is mirrored
    return Model(
        found,
        plane * [[1.0], [-1.0]],
        [image.name for image in images],
        centre * [1.0, -1.0],
        np.array([position[image.name] for image in images]),
    )


def _locate(
    database: Path, name: str, retrieved: Sequence[str], *, models: Sequence[Model]
) -> list[float] | None:
    """Solve the pose in the model with the most inliers, and return its map position; None without a pose."""
    poses = [
        (pose["num_inliers"], pose, model)
        for model in models
        if (pose := _pose(database, name, retrieved, model=model))
    ]
    if not poses:
        return None
    inliers, pose, model = max(poses, key=lambda p: p[0])
    if inliers < _FEWEST_INLIERS:
        return None
    centre = model.plane @ pose["cam_from_world"].inverse().translation
    return _to_map(model, centre)


def _pose(database: Path, name: str, retrieved: Sequence[str], *, model: Model) -> dict[str, Any] | None:
    pixels, points = [], []
    number = {image.name: image for image in model.found.images.values()}
    with pycolmap.Database.open(database) as opened:
        query = opened.read_image_with_name(name)
        if query is None:
            return None
        camera = opened.read_camera(query.camera_id)
        keypoints = np.asarray(opened.read_keypoints(query.image_id).data)[:, :2]
        for other in retrieved:
            if other not in number:
                continue
            image = number[other]
            verified = opened.read_two_view_geometry(query.image_id, image.image_id).inlier_matches
            for mine, theirs in np.asarray(verified, np.int64).reshape(-1, 2):
                point = image.points2D[theirs]
                if point.has_point3D():
                    pixels.append(keypoints[mine])
                    points.append(model.found.points3D[point.point3D_id].xyz)
    if len(points) < _FEWEST_INLIERS:
        return None
    same = [c for c in model.found.cameras.values() if (c.width, c.height) == (camera.width, camera.height)]
    refine = pycolmap.AbsolutePoseRefinementOptions()
    refine.refine_focal_length = not same
    found: dict[str, Any] | None = pycolmap.estimate_and_refine_absolute_pose(
        np.array(pixels) + 0.5, np.array(points), same[0] if same else camera, refinement_options=refine
    )
    return found


def _to_map(model: Model, centre: Array) -> list[float]:
    """Transform a point of the model's plane to map pixels by a similarity, robustly fitted around it."""
    near = np.argsort(((model.centre - centre) ** 2).sum(1))[:NEAR]
    source = model.centre[near] @ [1.0, 1.0j]
    target = model.position[near] @ [1.0, 1.0j]
    weight = np.ones(len(near))
    for _ in range(_ROUNDS):
        a, b = (weight @ v / weight.sum() for v in (source, target))
        turn = (
            weight @ (np.conj(source - a) * (target - b)) / max(float(weight @ abs(source - a) ** 2), 1e-12)
        )
        off = abs(b + turn * (source - a) - target)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    at = b + turn * (complex(*centre) - a)
    return [at.real, at.imag]


if __name__ == "__main__":
    sys.exit(main())
