"""Compares features on one map, with the figures of a field experiment, and prints one table.

For each kind an index is built from scratch and the same photos are localized. Medians over the queries;
grades are counts of excellent/good/sufficient/insufficient, of the first hypothesis and of the best other.

    python -m benchmarks.features_table MAP.cfg QUERIES.csv [--method vote] [--limit N] [--json OUT] [more]

XFeat needs its weights (`expmap models fetch`). Other options, such as --fov, go to `expmap evaluate`.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

GRADES = ("excellent", "good", "sufficient", "insufficient")

COLUMNS = {
    "keypoints": "keypoints",
    "map_keypoints": "on the map",
    "matches": "matches",
    "matches_pruned": "pruned to",
    "distance_min": "min dist",
    "distance_max": "max dist",
    "distance_mean": "mean dist",
    "distance_total": "sum dist",
    "index_mb": "index MB",
    "peak_mb": "peak MB",
    "build_seconds": "build s",
    "extract_seconds": "extract s",
    "seconds": "query s",
    "first_px": "first px",
    "worst_px": "worst px",
    "first_m": "first m",
    "worst_m": "worst m",
    "grades_first": "grades of first",
    "grades_others": "of others",
}


def main() -> None:
    """Measure all kinds of features and print the table."""
    arguments, options = _parser().parse_known_args()
    rows = []
    for features in arguments.features.split(","):
        print(f"measuring {features}", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(
                {
                    "features": features,
                    **_measure(features, arguments, options=options, scratch=Path(scratch)),
                }
            )
    _print(rows)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--features", default="surf,sift,orb,xfeat", help="names, with commas")
    parser.add_argument("--method", default="vote", choices=("vote", "verified", "thorough"))
    parser.add_argument("--limit", type=int, help="queries, evenly spread")
    parser.add_argument("--json", type=Path, help="write all figures there")
    return parser


def _measure(
    features: str, arguments: argparse.Namespace, *, options: list[str], scratch: Path
) -> dict[str, Any]:
    common = [
        "--features",
        features,
        "--method",
        arguments.method,
        "--index",
        str(scratch / "index"),
        *options,
    ]
    limit = ["--limit", str(arguments.limit)] if arguments.limit else []
    where = [str(arguments.map), str(arguments.queries)]
    # the evaluation builds the index, so that the figures of the build are of these features only
    done = _run("evaluate", *where, "--json", "-o", str(scratch / "report"), *limit, *common)
    with (scratch / "report" / "results.csv").open(encoding="utf-8", newline="") as file:
        queries = list(csv.DictReader(file, delimiter=";"))
    built = _run("build", str(arguments.map), "--json", *common)
    measured = {key: _median(queries, key) for key in COLUMNS if queries and key in queries[0]}
    return measured | {
        "map_keypoints": built["descriptors"],
        "index_mb": done["index_bytes"] / 1e6,
        "peak_mb": done["peak_rss_mb"],
        "build_seconds": done["build_seconds"],
        "extract_seconds": done["extract_seconds_p50"],
        "grades_first": _grades(queries, "grade_first"),
        "grades_others": _grades(queries, "grade_others"),
    }


def _run(command: str, *arguments: str) -> dict[str, Any]:
    call = [sys.executable, "-m", "webapp.app.main", command, *arguments]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(call)} ended with {done.returncode}:\n{done.stderr}")
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


def _median(queries: list[dict[str, str]], key: str) -> float | None:
    known = [float(query[key]) for query in queries if query[key]]
    return statistics.median(known) if known else None


def _grades(queries: list[dict[str, str]], key: str) -> str:
    found = Counter(query[key] for query in queries)
    return "/".join(str(found[grade]) for grade in GRADES)


def _print(rows: list[dict[str, Any]]) -> None:
    """Print one line per figure, one column per kind of features."""
    print(f"{'':<16}" + "".join(f"{row['features']:>18}" for row in rows))
    for key, title in COLUMNS.items():
        print(f"{title:<16}" + "".join(f"{_cell(row.get(key)):>18}" for row in rows))


def _cell(value: float | str | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"


if __name__ == "__main__":
    main()
