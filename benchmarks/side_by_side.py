"""Compares the methods with another program on the same map: accuracy, time and memory.

    python -m benchmarks.side_by_side MAP.cfg QUERIES.csv [--baseline PROGRAM.py] [--only SIFT]
        [--methods verified] [--limit N] [--foreign FOLDER] [--fov DEGREES] [--built] [--json OUT] [more]

The other program is called as `PROGRAM MAP.cfg QUERIES.csv [--features SIFT|ORB] [--limit N]` and prints one
JSON object with within_10px ... and match_seconds_p50; one example is the thesis method in plain OpenCV.

For each kind of features an index is first built from scratch in a temporary folder, or with --built the
index next to the map is used. Options that are not listed here, such as --map-fov, go to each `expmap`
command.

- accuracy: share of queries whose first hypothesis is within a distance; median and mean error, map pixels
- honesty: calibration figures with 95 % intervals; "foreign placed" are photos of the --foreign folders that
  got a place with a probability of at least 0.5
- cost of a query: milliseconds, medians except p95; "/base" is relative to the baseline's median query; CPU
  is of all cores together, and unknown for the other program, whose build dominates it;
  KB/photo = (peak of a localizing process - the same on a map of one photo) / photos, of which "private" is
  not in mapped files; all threads share one heap, without which this varies by 200 KB/photo on small maps.
  The difference includes what a query takes more where there are photos to compare it with
- build: seconds per photo for keypoints and index, wall time and of all cores; then orienting and calibrating

Other work on the machine makes all times worse: "load" is the load average when the measurement began.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.figures import (
    Row,
    each,
    per_photo_kb,
    placed,
    plain,
    ratio,
    stage_seconds,
    strangers,
    table,
    with_interval,
)
from benchmarks.processes import ProgramFailed, Run, run

MISSING_PART, SOME_FAILED = 4, 1
"""Exit codes of `expmap`."""

PHOTOS = {".jpg", ".jpeg", ".png", ".heic", ".webp", ".tif", ".tiff", ".bmp"}

ACCURACY = {
    "<=10 px": plain("within_10px"),
    "<=20 px": plain("within_20px"),
    "<=50 px": plain("within_50px"),
    "<=100 px": plain("within_100px"),
    "top 5 <=50": plain("top5_within_50px"),
    "median px": plain("median_px", 1),
    "mean px": plain("mean_px", 1),
}
HONESTY = {
    "ECE": with_interval("ece"),
    "in 68 % radius": with_interval("radius_coverage"),
    "answered at 99 %": with_interval("answered_at_99_precision"),
    "foreign placed": placed,
    "largest p": plain("foreign_largest"),
    "99 % of p": plain("foreign_q99"),
}
COST = {
    "read ms": plain("stage_read", 1, times=1e3),
    "extract": plain("stage_extract", 1, times=1e3),
    "retrieve": plain("stage_retrieve", 1, times=1e3),
    "verify": plain("stage_verify", 1, times=1e3),
    "position": plain("stage_position", 1, times=1e3),
    "total": plain("total_seconds_p50", 1, times=1e3),
    "p95": plain("total_seconds_p95", 1, times=1e3),
    "/base": plain("p50_over_baseline", 2),
    "p95/base": plain("p95_over_baseline", 2),
    "CPU": plain("cpu_seconds_per_query", 1, times=1e3),
    "KB/photo": plain("memory_kb_per_photo", 1),
    "private": plain("private_kb_per_photo", 1),
    "disk KB": plain("disk_kb_per_photo", 1),
    "load": plain("load", 1),
}
BUILD = {
    "index s/photo": plain("build_seconds_per_photo", 4),
    "CPU s/photo": plain("build_cpu_seconds_per_photo", 4),
    "/base": plain("build_over_baseline", 2),
    "CPU/base": plain("build_cpu_over_baseline", 2),
    "orient s": plain("orientation_seconds", 1),
    "calibrate s": plain("calibration_seconds", 1),
    "load": plain("build_load", 1),
}


@dataclass(frozen=True, slots=True)
class Subject:
    """The test data and options.

    Attributes:
    ----------
    map, queries, one_photo : Path
        The map, the list of queries, and the same map with one photo.
    photos : int
        Number of photos of the map.
    asked, foreign : list of str
        Photos that are localized: queries, and photos from elsewhere.
    options : list of str
        Options for every `expmap` command.
    fov, foreign_fov : list of str
        Options with the field of view of the queries and of photos from elsewhere.
    """

    map: Path
    queries: Path
    one_photo: Path
    photos: int
    asked: list[str]
    foreign: list[str]
    options: list[str]
    fov: list[str]
    foreign_fov: list[str]


def main() -> None:
    """Run all measurements and print the tables."""
    arguments = _arguments()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for features in arguments.only or ["SIFT", "XFEAT"]:
            limit = arguments.orb_limit if features == "ORB" else arguments.limit
            subject = _subject(arguments, Path(scratch), limit=limit)
            if arguments.baseline and features != "XFEAT":
                rows.append(_baseline(arguments.baseline, subject, features=features, limit=limit))
            try:
                rows += _ours(subject, features, arguments, scratch=Path(scratch) / features)
            except ProgramFailed as error:
                if error.code != MISSING_PART:
                    raise
                print(f"{features} is not measured: {error.messages.strip()}", file=sys.stderr)
    _compare(rows)
    print(_text(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("map", type=Path)
    add("queries", type=Path)
    add("--baseline", type=Path, help="the other program")
    add("--limit", type=int, default=0, help="queries, evenly spread; 0 for all")
    add("--orb-limit", type=int, default=0, help="queries with ORB; 0 for all")
    add("--only", action="append", choices=["SIFT", "XFEAT", "ORB"], help="these features; may be repeated")
    add("--methods", default="vote,verified", help="names, with commas")
    add(
        "--foreign",
        action="append",
        type=Path,
        default=[],
        help="folder of photos from elsewhere; repeatable",
    )
    add("--fov", help="field of view of the queries, degrees")
    add("--foreign-fov", help="that of photos from elsewhere; else their EXIF, or a guess, decides")
    add("--built", action="store_true", help="take the index next to the map; the build is not measured")
    add("--cost-queries", type=int, default=100, help="photos for CPU seconds and memory, evenly spread")
    add("--json", type=Path, help="write all figures there")
    arguments, arguments.options = parser.parse_known_args()
    return arguments


def _subject(arguments: argparse.Namespace, scratch: Path, *, limit: int) -> Subject:
    with arguments.queries.open(encoding="utf-8-sig", newline="") as file:
        names = [line["path"] for line in csv.DictReader(file, delimiter=";")]
    asked = [str(arguments.queries.resolve().parent / name) for name in names]
    count = min(len(asked), limit or len(asked), arguments.cost_queries)
    lines = arguments.map.read_text("utf-8-sig").splitlines()
    return Subject(
        map=arguments.map,
        queries=arguments.queries,
        one_photo=one_photo_map(arguments.map, scratch / "one"),
        photos=sum(bool(line.strip()) for line in lines[1:]),
        asked=[asked[i * len(asked) // count] for i in range(count)],
        foreign=[str(path) for folder in arguments.foreign for path in photos_in(folder)],
        options=arguments.options,
        fov=["--fov", arguments.fov] if arguments.fov else [],
        foreign_fov=["--fov", arguments.foreign_fov] if arguments.foreign_fov else [],
    )


def photos_in(folder: Path) -> Iterator[Path]:
    """Find the photos of a folder and its subfolders by their suffixes, sorted by path."""
    return (path for path in sorted(folder.rglob("*")) if path.suffix.lower() in PHOTOS)


def one_photo_map(cfg: Path, folder: Path) -> Path:
    """Copy a map with only its first photo; return the new map file."""
    image, first = cfg.read_text("utf-8-sig").splitlines()[:2]
    for name in (image.split(";")[0].strip(), first.split(";")[1].strip()):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(cfg.parent / name, folder / name)
    target = folder / "map.cfg"
    target.write_text(f"{image}\n{first}\n", "utf-8")
    return target


def _baseline(program: Path, subject: Subject, *, features: str, limit: int) -> dict[str, Any]:
    """Measure the other program: with one query (for its build), with all, and on a map of one photo."""
    call = [sys.executable, str(program)]
    kind = ["--features", features]
    where = [str(subject.map), str(subject.queries), *kind]
    built = run([*call, *where, "--limit", "1"])
    whole = run([*call, *where, *(["--limit", str(limit)] if limit else [])], one_heap=True)
    queries = subject.one_photo.with_name("queries.csv")
    queries.write_text("\n".join(["path;x;y", *(f"{path};0;0" for path in subject.asked)]) + "\n", "utf-8")
    small = run([*call, str(subject.one_photo), str(queries), *kind], one_heap=True)
    figures = whole.printed
    seconds = built.printed.get("map_extract_s", 0.0) + built.printed.get("map_index_s", 0.0)
    return {
        "name": f"baseline {features}",
        **figures,
        "stage_extract": figures.get("extract_seconds_p50"),
        "stage_retrieve": figures.get("match_seconds_p50"),
        "memory_kb_per_photo": per_photo_kb(whole.peak_rss_mb, small.peak_rss_mb, photos=subject.photos),
        "build_seconds_per_photo": seconds / subject.photos or None,
        "build_cpu_seconds_per_photo": built.cpu_seconds / subject.photos,
        "load": whole.load,
        "build_load": built.load,
    }


def _ours(
    subject: Subject, features: str, arguments: argparse.Namespace, *, scratch: Path
) -> list[dict[str, Any]]:
    kind = ["--features", features, *subject.options]
    build: dict[str, Any] = {}
    if not arguments.built:
        kind += ["--index", str(scratch / "index")]
        index = _expmap("build", str(subject.map), *kind, "--method", "vote", "--json")
        build = {
            "build_seconds_per_photo": index.printed["seconds"] / subject.photos,
            "build_cpu_seconds_per_photo": index.cpu_seconds / subject.photos,
            "build_load": index.load,
        }
    rows = []
    for method in arguments.methods.split(","):
        options = [*kind, "--method", method]
        if build and method == "verified":
            built = _expmap("build", str(subject.map), *options, "--json").printed
            build = {
                **build,
                **{f"{n}_seconds": built[f"{n}_seconds"] for n in ("orientation", "calibration")},
            }
        rows.append(
            {
                "name": f"{method} {features}",
                **_asked(
                    subject, options, limit=arguments.limit if features != "ORB" else arguments.orb_limit
                ),
                **_cost(subject, options, one_photo_index=scratch / "one"),
                **(_foreign(subject, options) if subject.foreign else {}),
                **build,
            }
        )
    return rows


def _asked(subject: Subject, options: list[str], *, limit: int) -> dict[str, Any]:
    """Evaluate the queries with known truth."""
    limited = ["--limit", str(limit)] if limit else []
    done = _expmap(
        "evaluate", str(subject.map), str(subject.queries), *limited, *subject.fov, *options, "--json"
    )
    figures: dict[str, Any] = done.printed
    answers = [query["answer"] for query in figures.pop("per_query")]
    return {
        **figures,
        **stage_seconds(answers),
        "total_seconds_p50": figures["seconds_per_query_p50"],
        "total_seconds_p95": figures["seconds_per_query_p95"],
        "disk_kb_per_photo": figures["index_bytes"] / 1000.0 / subject.photos,
        "load": done.load,
    }


def _cost(subject: Subject, options: list[str], *, one_photo_index: Path) -> dict[str, Any]:
    """Measure CPU seconds and memory of processes that do nothing but localize."""
    asked = [*subject.fov, *options, "--json"]
    one = _expmap("localize", str(subject.map), subject.asked[0], *asked, one_heap=True)
    many = _expmap("localize", str(subject.map), *subject.asked, *asked, one_heap=True)
    elsewhere = ["--index", str(one_photo_index)]
    _expmap("localize", str(subject.one_photo), subject.asked[0], *asked, *elsewhere)  # builds the index
    small = _expmap("localize", str(subject.one_photo), *subject.asked, *asked, *elsewhere, one_heap=True)
    private = None
    if many.private_mb is not None and small.private_mb is not None:
        private = per_photo_kb(many.private_mb, small.private_mb, photos=subject.photos)
    return {
        "cpu_seconds_per_query": each(many.cpu_seconds, one.cpu_seconds, more=len(subject.asked) - 1),
        "memory_kb_per_photo": per_photo_kb(many.peak_rss_mb, small.peak_rss_mb, photos=subject.photos),
        "private_kb_per_photo": private,
        "localizing_peak_mb": many.peak_rss_mb,
        "one_photo_peak_mb": small.peak_rss_mb,
    }


def _foreign(subject: Subject, options: list[str]) -> dict[str, Any]:
    where = [*subject.foreign_fov, *options, "--json"]
    return strangers(_expmap("localize", str(subject.map), *subject.foreign, *where).printed)


def _expmap(command: str, *arguments: str, one_heap: bool = False) -> Run:
    return run(
        [sys.executable, "-m", "webapp.app.main", command, *arguments],
        accepted=(0, SOME_FAILED) if command == "localize" else (0,),
        one_heap=one_heap,
    )


def _compare(rows: list[dict[str, Any]]) -> None:
    """Add the ratios to the first baseline."""
    base: Row = next((row for row in rows if row["name"].startswith("baseline")), {})
    ratios = {
        "p50_over_baseline": ("total_seconds_p50", "total_seconds_p50"),
        "p95_over_baseline": ("total_seconds_p95", "total_seconds_p50"),
        "build_over_baseline": ("build_seconds_per_photo", "build_seconds_per_photo"),
        "build_cpu_over_baseline": ("build_cpu_seconds_per_photo", "build_cpu_seconds_per_photo"),
    }
    for row in rows:
        for name, (key, base_key) in ratios.items():
            row[name] = ratio(row.get(key), base.get(base_key))


def _text(rows: list[dict[str, Any]]) -> str:
    tables = {"accuracy": ACCURACY, "honesty": HONESTY, "cost of a query": COST, "build": BUILD}
    return "\n\n".join(table(title, columns, rows) for title, columns in tables.items())


if __name__ == "__main__":
    main()
