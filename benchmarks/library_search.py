"""Measures the ranking of maps for a photo whose map is unknown: accuracy, and time in large libraries.

    python -m benchmarks.library_search FOLDER... [--index FOLDER] [--limit N] [--photos N] [--maps N]
        [--postgresql]

Each FOLDER holds a `map.cfg` with its index and a `queries.csv` of photos that were taken on it. The basis of
the photo vectors is trained on a sample of all maps, as in a library, and, for "map left out", on the other
maps only.

Then a library with --photos photos on --maps maps is simulated by adding noise to the real vectors. A search
in it is timed, without the extraction of the query: in memory and, with --postgresql, by pgvector in a server
that this starts, for a user who sees all maps and for one who sees a tenth of them. For pgvector the recall
of the 20 most similar maps and of the 20 most similar photos is printed, too.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.many_maps import fill
from tests.postgresql_server import PostgresqlServer
from webapp.core.features.extract import extract
from webapp.core.retrieval import global_descriptors
from webapp.files.photos.photo import read_gray
from webapp.settings import Settings
from webapp.store.backends import photo_search
from webapp.store.library import Library, open_library
from webapp.store.maps import photo_vectors as stored
from webapp.tasks.find import find_map
from webapp.tasks.find.describe_library import SAMPLE_PHOTOS, features, indexed_photos

NOISE = 0.05
"""Standard deviation of the noise added to each component of a real vector, whose length is 1."""

REPEATS, RECALL_AT = 20, 20
ROUNDING = 1e-5
"""Rounding error of cosines computed by the database."""

Descriptors = NDArray[np.uint8]


def main() -> None:
    """Print the accuracy and the timings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--index", type=Path, help="has a folder of indexes for each map, by its name")
    parser.add_argument("--limit", type=int, default=40, help="queries of each map, evenly spread")
    parser.add_argument("--photos", type=int, default=1_000_000)
    parser.add_argument("--maps", type=int, default=10_000)
    parser.add_argument("--postgresql", action="store_true", help="search in a database, too")
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
    library = _library(basis, maps, photos=arguments.photos, count=arguments.maps)
    asked = [global_descriptors.photo_vector(basis, q) for some in queries.values() for q in some][:REPEATS]
    _time(library, asked)
    if arguments.postgresql:
        _time_postgresql(library, asked, basis=basis)


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


def _basis(maps: dict[str, list[Descriptors]], *, leave_out: str | None) -> global_descriptors.Basis:
    photos = [p for name, some in maps.items() if name != leave_out for p in some]
    count = min(SAMPLE_PHOTOS, len(photos))
    chosen = np.random.default_rng(1).choice(len(photos), count, replace=False)
    return global_descriptors.train_basis([photos[i] for i in chosen])


def _matrix(basis: global_descriptors.Basis, photos: list[Descriptors]) -> NDArray[np.float16]:
    return np.array([global_descriptors.photo_vector(basis, p) for p in photos], np.float16)


def _ranks(
    name: str,
    maps: dict[str, list[Descriptors]],
    queries: list[Descriptors],
    *,
    basis: global_descriptors.Basis,
) -> NDArray[np.int64]:
    """Return for each query the number of maps that are ranked before the right one."""
    vectors = {other: _matrix(basis, photos) for other, photos in maps.items()}
    ranks = []
    for query in queries:
        asked = global_descriptors.photo_vector(basis, query)
        likeness = {other: find_map.likeness(some, asked) for other, some in vectors.items()}
        ranks.append(sum(value > likeness[name] for value in likeness.values()))
    return np.array(ranks)


def _library(
    basis: global_descriptors.Basis, maps: dict[str, list[Descriptors]], *, photos: int, count: int
) -> list[NDArray[np.float16]]:
    """Simulate the vectors of a large library, map by map."""
    rng = np.random.default_rng(1)
    real = np.concatenate([_matrix(basis, some) for some in maps.values()]).astype(np.float32)
    library = []
    for rows in np.array_split(np.arange(photos), count):
        some = real[rows % len(real)] + rng.normal(0.0, NOISE, (len(rows), real.shape[1])).astype(np.float32)
        library.append((some / np.linalg.norm(some, axis=1, keepdims=True)).astype(np.float16))
    return library


def _time(library: list[NDArray[np.float16]], asked: list[NDArray[np.float32]]) -> None:
    seconds = []
    for query in asked:
        begun = time.perf_counter()
        sorted(range(len(library)), key=[-find_map.likeness(v, query) for v in library].__getitem__)
        seconds.append(time.perf_counter() - begun)
    photos, size = sum(map(len, library)), sum(vectors.nbytes for vectors in library) / 1e6
    print(f"{photos} photos on {len(library)} maps, in memory: {_spread(seconds)}; {size:.0f} MB", flush=True)


def _time_postgresql(
    library: list[NDArray[np.float16]], asked: list[NDArray[np.float32]], *, basis: global_descriptors.Basis
) -> None:
    server = PostgresqlServer()
    try:
        with tempfile.TemporaryDirectory() as folder:
            there = open_library(Path(folder), url=server.new_database(empty=True))
            basis_id = _keep(there, library, basis)
            search = there.database.photo_search
            assert search is not None
            _set(there, "maintenance_work_mem = '1GB'")  # as the guide recommends for the first build
            begun = time.perf_counter()
            search.refresh()
            seconds = time.perf_counter() - begun
            size = _scalar(there, "SELECT pg_total_relation_size('photo_vector')") / sum(map(len, library))
            print(f"first filled in {seconds:.0f} s, {size:.0f} bytes a photo in the database", flush=True)
            begun = time.perf_counter()
            _keep_map(there, 1, np.concatenate([library[0], library[1]]), basis_id=basis_id)
            search.refresh()
            print(f"{len(library[1])} photos more in {time.perf_counter() - begun:.2f} s")
            _keep_map(there, 1, library[0], basis_id=basis_id)
            search.refresh()
            for name, step in (("all", 1), ("a tenth", 10)):
                _compare(there, library, asked, basis_id=basis_id, name=name, step=step)
            there.database.close()
    finally:
        server.remove()


def _set(there: Library, setting: str) -> None:
    with there.database.engine.connect() as connection:
        commands = connection.execution_options(isolation_level="AUTOCOMMIT")
        commands.exec_driver_sql(f"ALTER SYSTEM SET {setting}")
        commands.exec_driver_sql("SELECT pg_reload_conf()")


def _scalar(there: Library, query: str) -> float:
    with there.database.engine.connect() as connection:
        return float(connection.exec_driver_sql(query).scalar_one())


def _keep(there: Library, library: list[NDArray[np.float16]], basis: global_descriptors.Basis) -> int:
    fill(there, maps=len(library), photos=0)
    with there.database.write() as session:
        basis_id = stored.add_basis(session, basis, photos=1)
        stored.use_basis(session, basis_id)
    for number, vectors in enumerate(library):
        _keep_map(there, number + 1, vectors, basis_id=basis_id)
    return basis_id


def _keep_map(there: Library, map_id: int, vectors: NDArray[np.float16], *, basis_id: int) -> None:
    named = {f"{map_id:032x}{number:032x}": vector for number, vector in enumerate(vectors)}
    with there.database.write() as session:
        stored.keep_vectors(session, map_id, basis_id=basis_id, vectors=named)


def _compare(
    there: Library,
    library: list[NDArray[np.float16]],
    asked: list[NDArray[np.float32]],
    *,
    basis_id: int,
    name: str,
    step: int,
) -> None:
    """Time the searches of a user who sees every `step`-th map, and compare them with exact results."""
    search = there.database.photo_search
    assert search is not None
    seen = [*range(step, len(library) + 1, step)]
    seconds, maps, photos = [], [], []
    for query in asked:
        begun = time.perf_counter()
        found = search.likeness(query, basis_id=basis_id, map_ids=seen)
        seconds.append(time.perf_counter() - begun)
        exact = {id: find_map.likeness(library[id - 1], query) for id in seen}
        maps.append(len(_first(found) & _first(exact)) / RECALL_AT)
        every = np.concatenate([library[id - 1].astype(np.float32) @ query for id in seen])
        photos.append(_recall(there, query, basis_id=basis_id, seen=seen, every=every))
    print(
        f"{name} of {len(library)} maps seen, pgvector: {_spread(seconds)}; "
        f"recall@{RECALL_AT} of maps {np.mean(maps):.3f}, of photos {np.mean(photos):.3f}",
        flush=True,
    )


def _recall(
    there: Library, query: NDArray[np.float32], *, basis_id: int, seen: list[int], every: NDArray[np.float32]
) -> float:
    """Compute the share of the `RECALL_AT` most similar photos that the index finds."""
    vector = f"[{','.join(map(repr, query.tolist()))}]"
    values = {"query": vector, "basis": basis_id, "maps": seen, "nearest": photo_search.NEAREST}
    with there.database.engine.begin() as connection:
        nearest = photo_search._nearest(connection, values)
    least = float(np.partition(every, -RECALL_AT)[-RECALL_AT]) - ROUNDING
    return min(sum(likeness >= least for _, likeness in nearest) / RECALL_AT, 1.0)


def _first(likeness: dict[int, float]) -> set[int]:
    return {*sorted(likeness, key=likeness.__getitem__, reverse=True)[:RECALL_AT]}


def _spread(seconds: list[float]) -> str:
    median, p95 = np.percentile(seconds, [50, 95])
    return f"{median:.3f} s, 95 % {p95:.3f} s"


if __name__ == "__main__":
    main()
