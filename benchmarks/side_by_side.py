"""Measures the methods beside another program on the same map, in turn, and prints one table.

The other program is called as `PROGRAM MAP.cfg QUERIES.csv [--features SIFT|ORB] [--limit N]` and prints one
JSON object with within_10px ... and match_seconds_p50; the thesis method in plain OpenCV is such a one.

    python benchmarks/side_by_side.py MAP.cfg QUERIES.csv --baseline PROGRAM.py [--orb-limit 30]
        [--only SIFT] [--json OUT]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

COLUMNS = {
    "within_10px": "<=10 px",
    "within_20px": "<=20 px",
    "within_50px": "<=50 px",
    "within_100px": "<=100 px",
    "median_px": "median px",
    "mean_px": "mean px",
    "match_seconds_p50": "match s",
    "total_seconds_p50": "query s",
    "total_seconds_p95": "p95 s",
    "peak_rss_mb": "peak MB",
    "ece": "ECE",
    "radius_coverage": "in radius",
}


def main() -> None:
    """Run everything and print the table."""
    arguments = _arguments()
    rows: list[dict[str, Any]] = []
    limits = {"SIFT": arguments.limit, "ORB": arguments.orb_limit}
    for features in arguments.only or limits:
        limit = limits[features]
        limited = ["--limit", str(limit)] if limit else []
        where = [str(arguments.map), str(arguments.queries)]
        if arguments.baseline:
            command = [sys.executable, str(arguments.baseline), *where, "--features", features, *limited]
            rows.append({"name": f"baseline {features}", **_run(command)})
        for method in ("vote", "verified"):
            command = [sys.executable, "-m", "webapp.cli.main", "evaluate", *where, *limited]
            command += ["--features", features, "--method", method, "--json", *arguments.options]
            rows.append({"name": f"{method} {features}", **_same_names(_run(command))})
    _print(rows)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--baseline", type=Path, help="the other program")
    parser.add_argument("--limit", type=int, default=0, help="queries with SIFT; 0 for all")
    parser.add_argument("--orb-limit", type=int, default=0, help="queries with ORB; 0 for all")
    parser.add_argument(
        "--only", action="append", choices=["SIFT", "ORB"], help="these features; may be repeated"
    )
    parser.add_argument("--json", type=Path, help="write all figures there")
    arguments, options = parser.parse_known_args()
    arguments.options = options
    return arguments


def _run(command: list[str]) -> dict[str, Any]:
    print("running", *command[1:], file=sys.stderr, flush=True)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    figures: dict[str, Any] = json.loads(done.stdout)
    figures.pop("per_query", None)
    return figures


def _same_names(figures: dict[str, Any]) -> dict[str, Any]:
    figures["total_seconds_p50"] = figures["seconds_per_query_p50"]
    figures["total_seconds_p95"] = figures["seconds_per_query_p95"]
    return figures


def _print(rows: list[dict[str, Any]]) -> None:
    print(f"{'':<15}" + "".join(f"{title:>10}" for title in COLUMNS.values()))
    for row in rows:
        cells = (row.get(key) for key in COLUMNS)
        print(f"{row['name']:<15}" + "".join(f"{'-' if c is None else format(c, '.3f'):>10}" for c in cells))


if __name__ == "__main__":
    main()
