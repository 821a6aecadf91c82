"""Compares time and result of a build on Dask with one in local processes, on as many cores.

    python -m benchmarks.dask_build MAP.cfg [--photos 200] [--runs 3] [--workers 2] [--json OUT]

A scheduler and its workers are started here, one thread each. Both kinds of builds alternate, each into its
own folder, from copies of the first photos of the map. The method is `verified`, with all stages of a build,
including trials. The first build on Dask, in which workers load the program, is not counted.

- seconds: time of each run; ratio: of the medians
- equal: whether all files are identical except for times in them
- load: of the machine before each run, since other work makes all times worse
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.build_map import build_map
from webapp.tasks.localize.plan import OpenOptions
from webapp.threads import cores

_TIMES = re.compile(rb'"\w*seconds\w*": ?[0-9.]+|"second_look_s": ?[0-9.]+')


def main() -> int:
    """Run the comparison; return 1 if the files differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cfg", type=Path)
    parser.add_argument("--photos", type=int, default=200)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--workers", type=int, default=cores())
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cfg = first_photos(asked.cfg, folder / "map", photos=asked.photos)
        with cluster(folder, workers=asked.workers) as address:
            result = compare(cfg, folder, address=address, runs=asked.runs, workers=asked.workers)
    text = json.dumps(result, indent=1)
    print(text)
    if asked.json:
        asked.json.write_text(text)
    return 0 if result["equal"] else 1


def first_photos(cfg: Path, folder: Path, *, photos: int) -> Path:
    """Make a map from copies of the first photos."""
    folder.mkdir()
    plan, *lines = cfg.read_text("utf-8").splitlines()
    image, rest = plan.split(";", 1)
    shutil.copyfile(cfg.parent / image, folder / "plan.png")
    kept = [f"plan.png;{rest}"]
    for line in lines[:photos]:
        id, photo, rest = line.split(";", 2)
        target = folder / f"{id}{Path(photo).suffix}"
        shutil.copyfile(cfg.parent / photo, target)
        kept.append(f"{id};{target.name};{rest}")
    path = folder / "map.cfg"
    path.write_text("\n".join(kept) + "\n", "utf-8")
    return path


@contextmanager
def cluster(folder: Path, *, workers: int) -> Iterator[str]:
    """Start a scheduler and workers on this machine."""
    facts = folder / "scheduler.json"
    command = [sys.executable, "-m", "dask"]
    here = ["--no-dashboard", "--scheduler-file", str(facts)]
    started = [
        subprocess.Popen([*command, "scheduler", "--host", "127.0.0.1", "--port", "0", *here], cwd=folder)
    ]
    while not facts.exists():
        time.sleep(0.1)
    own = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    env = {**os.environ, "MALLOC_ARENA_MAX": "1"}  # as in docs/cluster.md
    started += [
        subprocess.Popen([*command, "worker", *own, *here], cwd=folder, env=env) for _ in range(workers)
    ]
    try:
        time.sleep(8.0)
        yield json.loads(facts.read_text())["address"]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def compare(cfg: Path, folder: Path, *, address: str, runs: int, workers: int) -> dict[str, Any]:
    """Alternate the two kinds of builds; return the results."""
    ways = {"local": Settings(), "dask": Settings(dask=address)}
    build(cfg, folder / "warm", settings=ways["dask"], workers=workers)
    shutil.rmtree(folder / "warm")
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    found: list[dict[str, bytes]] = []
    loads = []
    for turn in range(runs):
        for way in (*ways,) if turn % 2 == 0 else (*reversed(ways),):
            loads.append(round(os.getloadavg()[0], 2))
            index = folder / way
            seconds[way].append(round(build(cfg, index, settings=ways[way], workers=workers), 2))
            print(f"{way}: {seconds[way][-1]} s", file=sys.stderr)
            found.append(lasting(index))
            shutil.rmtree(index)
    medians = {way: statistics.median(times) for way, times in seconds.items()}
    return {
        "photos": len(cfg.read_text("utf-8").splitlines()) - 1,
        "workers": workers,
        "seconds": seconds,
        "ratio": round(medians["dask"] / medians["local"], 3),
        "equal": all(one == found[0] for one in found),
        "files": len(found[0]),
        "load": loads,
    }


def build(cfg: Path, index: Path, *, settings: Settings, workers: int) -> float:
    """Build from scratch; return the seconds."""
    options = OpenOptions(method="verified", features="sift", index=index, jobs=workers)
    started = time.perf_counter()
    report = build_map(cfg, options, settings=settings, progress=Progress())
    seconds = time.perf_counter() - started
    if report.index.failed:
        raise SystemExit(f"photos could not be used: {report.index.failed[0]}")
    return seconds


def lasting(folder: Path) -> dict[str, bytes]:
    """Read all files of an index, removing times."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "lock")
    return {
        str(path.relative_to(folder)): _TIMES.sub(b"", data) if path.suffix == ".json" else data
        for path in files
        if path.suffix != ".trials"
        for data in [path.read_bytes()]
    }


if __name__ == "__main__":
    sys.exit(main())
