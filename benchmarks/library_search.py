"""Measures which map of a library is searched first for a photo, and how long that takes in large libraries.

    python -m benchmarks.library_search FOLDER... [--index FOLDER] [--limit N] [--photos N] [--maps N]

Each FOLDER holds a `map.cfg` with its index and a `queries.csv` of photos that were taken on it. The basis is
trained on a sample of all of them, as in a library, and, with "map left out", on those of the other maps.

Then there are as many photos as are asked for, on as many maps: vectors of the real ones with noise. A search
on them is timed, without the extraction of the query.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.extract import extract
from webapp.core.retrieval import photo_vectors
from webapp.files.photos.photo import read_gray
from webapp.settings import Settings
from webapp.tasks.find import rank_maps
from webapp.tasks.find.describe_library import SAMPLE_PHOTOS, features, indexed_photos

NOISE = 0.05
"""Standard deviation added to each number of a real vector, whose length is 1."""

REPEATS = 20
Descriptors = NDArray[np.uint8]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--index", type=Path, help="has a folder of indexes for each map, by its name")
    parser.add_argument("--limit", type=int, default=40, help="queries of each map, evenly spread")
    parser.add_argument("--photos", type=int, default=1_000_000)
    parser.add_argument("--maps", type=int, default=10_000)
    arguments = parser.parse_args()
    settings = Settings()
    maps: dict[str, list[Descriptors]] = {}
    queries: dict[str, list[Descriptors]] = {}
    for folder in arguments.folders:
        found = indexed_photos(
            folder / "map.cfg", settings=settings, index=arguments.index and arguments.index / folder.name
        )
        maps[folder.name] = [np.array(segment.entry(i).features.descriptors) for _, segment, i in found]
        queries[folder.name] = _queries(folder, arguments.limit, settings)
    print("map                photos  right map first / of first 3   map left out")
    basis = _basis(maps, leave_out=None)
    for name in maps:
        ranks = _ranks(name, maps, queries[name], basis=basis)
        others = _ranks(name, maps, queries[name], basis=_basis(maps, leave_out=name))
        shares = "   ".join(f"{np.mean(r < 1):14.3f} / {np.mean(r < 3):.3f}" for r in (ranks, others))
        print(f"{name:18s} {len(maps[name]):6d}  {shares}", flush=True)
    _time(basis, maps, queries, photos=arguments.photos, count=arguments.maps)


def _queries(folder: Path, limit: int, settings: Settings) -> list[Descriptors]:
    with (folder / "queries.csv").open(encoding="utf-8-sig", newline="") as file:
        names = [line["path"] for line in csv.DictReader(file, delimiter=";")]
    count = min(limit, len(names))
    chosen = [names[i * len(names) // count] for i in range(count)]
    asked = settings.extract
    grays = (read_gray(folder / n, limits=settings.photo, max_side=asked.max_side_px) for n in chosen)
    return [
        extract(g.pixels, features(), keypoints=asked.keypoints, scale=g.scale).descriptors for g in grays
    ]


def _basis(maps: dict[str, list[Descriptors]], *, leave_out: str | None) -> photo_vectors.Basis:
    photos = [p for name, some in maps.items() if name != leave_out for p in some]
    count = min(SAMPLE_PHOTOS, len(photos))
    chosen = np.random.default_rng(1).choice(len(photos), count, replace=False)
    return photo_vectors.train([photos[i] for i in chosen])


def _matrix(basis: photo_vectors.Basis, photos: list[Descriptors]) -> NDArray[np.float16]:
    return np.array([photo_vectors.vector(basis, p) for p in photos], np.float16)


def _ranks(
    name: str, maps: dict[str, list[Descriptors]], queries: list[Descriptors], *, basis: photo_vectors.Basis
) -> NDArray[np.int64]:
    """Count for each query the maps that come before the right one."""
    vectors = {other: _matrix(basis, photos) for other, photos in maps.items()}
    ranks = []
    for query in queries:
        asked = photo_vectors.vector(basis, query)
        likeness = {other: rank_maps.likeness(some, asked) for other, some in vectors.items()}
        ranks.append(sum(value > likeness[name] for value in likeness.values()))
    return np.array(ranks)


def _time(
    basis: photo_vectors.Basis,
    maps: dict[str, list[Descriptors]],
    queries: dict[str, list[Descriptors]],
    *,
    photos: int,
    count: int,
) -> None:
    rng = np.random.default_rng(1)
    real = np.concatenate([_matrix(basis, some) for some in maps.values()]).astype(np.float32)
    library = []
    for rows in np.array_split(np.arange(photos), count):
        some = real[rows % len(real)] + rng.normal(0.0, NOISE, (len(rows), real.shape[1])).astype(np.float32)
        library.append((some / np.linalg.norm(some, axis=1, keepdims=True)).astype(np.float16))
    size = sum(vectors.nbytes for vectors in library) / 1e6
    seconds = []
    asked = [photo_vectors.vector(basis, q) for some in queries.values() for q in some][:REPEATS]
    for query in asked:
        begun = time.perf_counter()
        sorted(range(count), key=[-rank_maps.likeness(vectors, query) for vectors in library].__getitem__)
        seconds.append(time.perf_counter() - begun)
    median, p95 = np.percentile(seconds, [50, 95])
    print(f"{photos} photos on {count} maps: {median:.3f} s, 95 % {p95:.3f} s; {size:.0f} MB")


if __name__ == "__main__":
    main()
