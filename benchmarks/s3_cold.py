"""Compares response times of a machine with the map in S3 and of one with the map in a local folder.

    python -m benchmarks.s3_cold MAP.cfg [--photos 300] [--queries 20] [--rounds 3] [--mb-s 100] [--ms 20]

An S3 server of `moto` runs in a separate process, with a bandwidth of --mb-s for all connections together and
a latency of --ms for each response. A copy of the first photos of the map is built once, with its
calibration, by method `verified`, and then copied to S3. Queries are photos of the map, cropped at the edges.
Each line of the table is the median of the rounds, in which the variants alternate, each in a new process
that has loaded the program:

- local: photos and index are files
- cold: they are objects, and the cache of the machine is empty
- warm: the same, in another process with that cache
- first: time until the first answer, including opening the map; next: time of a later answer
- fetched: MB in the cache after the last answer

The answers are compared, too. The folder itself, with map.cfg, pointers and manifests, is on this machine.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.dask_build import first_photos
from benchmarks.s3_server import BUCKET, ObjectServer
from webapp.errors import PhotoError
from webapp.files import contents
from webapp.files.contents import connect
from webapp.files.localize.index_store import IndexFolder
from webapp.files.maps.folder import read_map
from webapp.files.object_storage.storage import MARKER
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.build_map import build_map
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

_OPTIONS = OpenOptions(method="verified", features="sift")
_EDGE = 0.04
"""Share of a photo that is cropped on each side of queries."""


def main() -> int:
    """Measure and print a table; return 1 if answers differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cfg", type=Path)
    parser.add_argument("--photos", type=int, default=300)
    parser.add_argument("--queries", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--mb-s", type=float, default=100.0)
    parser.add_argument("--ms", type=float, default=20.0)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="of the built copy, to measure it again")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ObjectServer(asked.mb_s, asked.ms) as server:
        os.environ.update(server.environ)
        kept = asked.keep or Path(name, "local")
        if not (kept / "map.cfg").is_file():
            first_photos(asked.cfg, kept, photos=asked.photos)
        places = _prepare(kept / "map.cfg", Path(name), queries=asked.queries)
        measured = _measure(places, rounds=asked.rounds)
    result = _result(measured)
    print(_table(result))
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1))
    return 0 if result["equal"] else 1


@dataclass(frozen=True, slots=True)
class _Places:
    """Paths of the same map as files and as objects, of queries, and of caches."""

    local: Path
    stored: Path
    queries: tuple[Path, ...]
    caches: Path

    def settings(self, cache: str) -> Settings:
        """Return the settings of a machine; the database URL is required, but never used."""
        return Settings(
            database="postgresql+psycopg://nobody@localhost/none",
            storage=f"s3://{BUCKET}/library",
            cache_folder=self.caches / cache,
        )


def _prepare(local: Path, folder: Path, *, queries: int) -> _Places:
    """Build a map, and put a copy of it into S3."""
    report = build_map(local, _OPTIONS, settings=Settings(), progress=Progress())
    asked = tuple(cut_photos(local, folder / "queries", queries))
    library = folder / "library"
    shutil.copytree(local.parent, library / "map")
    places = _Places(local, library / "map" / local.name, asked, folder / "caches")
    (library / ".library").mkdir()
    (library / ".library" / MARKER).write_text(f"s3://{BUCKET}/library benchmark\n", "utf-8")
    connect(places.settings("builder"))
    for experience in read_map(places.stored).experiences:
        contents.publish(places.stored.parent / experience.photo)
    index = IndexFolder(places.stored.parent / report.index.folder.relative_to(local.parent))
    manifest = index.read_manifest()
    if manifest is None:
        raise SystemExit("the map has no index")
    index.publish(manifest)
    return places


def cut_photos(cfg: Path, folder: Path, count: int) -> Iterator[Path]:
    """Yield queries made from evenly spread photos of a map, cropped at the edges."""
    folder.mkdir()
    experiences = read_map(cfg).experiences
    for number in range(min(count, len(experiences))):
        source = cfg.parent / experiences[number * len(experiences) // count].photo
        target = folder / f"{number}.jpg"
        with Image.open(source) as photo:
            x, y = int(photo.width * _EDGE), int(photo.height * _EDGE)
            photo.convert("RGB").crop((x, y, photo.width - x, photo.height - y)).save(target, quality=90)
        yield target


@dataclass(frozen=True, slots=True)
class _Answers:
    """The answers that a process got, and their times."""

    first_s: float
    next_s: tuple[float, ...]
    said: str
    cached_mb: float


def _ask(cfg: Path, queries: Iterable[Path], settings: Settings) -> _Answers:
    """Open a map and localize photos, in a process that does nothing else."""
    connect(settings)
    begun = time.perf_counter()
    pipeline = open_pipeline(cfg, _OPTIONS, settings=settings, progress=Progress(), fov_deg=None)
    times: list[float] = []
    said: list[str] = []
    for query in queries:
        try:
            said.append(repr(pipeline.localize(query, top=3).hypotheses))
        except PhotoError as error:
            said.append(str(error))
        times.append(time.perf_counter() - begun)
        begun = time.perf_counter()
    there = contents.in_use()
    cached = there.cache.size() / 1e6 if there else 0.0
    return _Answers(times[0], tuple(times[1:]), json.dumps(said), cached)


def _measure(places: _Places, *, rounds: int) -> dict[str, list[_Answers]]:
    measured: dict[str, list[_Answers]] = {"local": [], "cold": [], "warm": []}
    for turn in range(rounds):
        there = places.settings(f"machine-{turn}")
        ways = (
            ("local", places.local, Settings()),
            ("cold", places.stored, there),
            ("warm", places.stored, there),
        )
        for name, cfg, settings in ways:
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                pool.submit(_loaded).result()
                measured[name].append(pool.submit(_ask, cfg, places.queries, settings).result())
    return measured


def _loaded() -> None:
    """Load the modules that a server has loaded before the first request."""
    import boto3

    boto3.client("s3")


def _result(measured: dict[str, list[_Answers]]) -> dict[str, Any]:
    first = {way: statistics.median(one.first_s for one in runs) for way, runs in measured.items()}
    later = {way: statistics.median(s for one in runs for s in one.next_s) for way, runs in measured.items()}
    return {
        way: {
            "first_s": round(first[way], 3),
            "first_runs_s": [round(one.first_s, 3) for one in runs],
            "first_ratio": round(first[way] / first["local"], 2),
            "next_s": round(later[way], 4),
            "next_ratio": round(later[way] / later["local"], 3),
            "fetched_mb": round(runs[-1].cached_mb, 1),
        }
        for way, runs in measured.items()
    } | {
        "equal": len({one.said for runs in measured.values() for one in runs}) == 1,
        "load": os.getloadavg()[0],
    }


def _table(result: dict[str, Any]) -> str:
    lines = [
        f"{'':6}{'first s':>9}{'ratio':>8}{'next ms':>9}{'ratio':>8}{'fetched MB':>12}  first of each round"
    ]
    for way in ("local", "cold", "warm"):
        one = result[way]
        runs = ", ".join(f"{s:.2f}" for s in one["first_runs_s"])
        lines.append(
            f"{way:6}{one['first_s']:9.2f}{one['first_ratio']:8.2f}{one['next_s'] * 1e3:9.0f}"
            f"{one['next_ratio']:8.2f}{one['fetched_mb']:12.1f}  {runs}"
        )
    lines.append("answers are equal" if result["equal"] else "ANSWERS DIFFER")
    return "\n".join([*lines, f"load of this machine at the end: {result['load']:.1f}"])


if __name__ == "__main__":
    sys.exit(main())
