"""Measures the methods on many maps of different kinds, and prints one table.

    python -m benchmarks.battery FOLDER [--methods vote,verified,auto] [--features SIFT,XFEAT] [--limit N]
        [--index FOLDER] [--foreign FOLDER] [--baseline PROGRAM.py ...] [--within NAME=PX ...]
        [--options "--keypoints 2000" ...] [--json OUT]

FOLDER holds maps, each a folder with `map.cfg` and `queries.csv`; `benchmarks.derived_maps` makes more.
Columns, for each map, features and method:

- kind, radius: kind of the map as detected by the program, and its place radius, map pixels;
- right: share of the queries whose first hypothesis is within the place radius, or within the distance given
  by --within for the map; the same for every method; "- vote": difference to `vote` with these features, or
  for `auto`, which chooses features itself, to the better one;
- median px; ECE; "in radius" (target: 68 %); answered at 99 %; refused: "not on this map"; "but right":
  share of the queries that were refused though their first hypothesis was right;
- foreign: share of the --foreign photos that got a place with a probability of at least 0.5; "off": their
  median probability of "not on this map";
- ms, mean, p95: median, mean and 95th percentile of the time of a query; MB: peak of the process; build s,
  calibrate s.

--baseline is another program with the interface described in `benchmarks.side_by_side`, such as
`benchmarks/peer_colmap.py`. --options adds options of `expmap evaluate` to the methods: measured once with
each, and once without. An index in the --index folder is reused, so that a second run measures queries only.
--json is rewritten with the figures after each map.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.figures import mean_seconds, plain, ratio, refused_though_right, strangers, table
from benchmarks.processes import ProgramFailed, run
from benchmarks.side_by_side import MISSING_PART, SOME_FAILED, photos_in

AUTO = "auto"

COLUMNS = {
    "kind": lambda row: row.get("map_kind") or "-",
    "radius": plain("place_radius_px", 0),
    "right": plain("right"),
    "- vote": plain("over_vote"),
    "median px": plain("median_px", 1),
    "ECE": plain("ece"),
    "in radius": plain("radius_coverage", 2),
    "at 99 %": plain("answered_at_99_precision", 2),
    "refused": plain("refused", 2),
    "but right": plain("refused_though_right", 2),
    "foreign": plain("foreign_share"),
    "off": plain("foreign_off_map_p50", 2),
    "ms": plain("seconds_per_query_p50", 0, times=1e3),
    "mean": plain("seconds_per_query_mean", 0, times=1e3),
    "p95": plain("seconds_per_query_p95", 0, times=1e3),
    "MB": plain("peak_rss_mb", 0),
    "build s": plain("build_seconds", 0),
    "calibrate s": plain("calibration_seconds", 0),
}


def main() -> None:
    """Run all measurements and print the table."""
    arguments = _arguments()
    within = dict(pair.split("=", 1) for pair in arguments.within)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        index = arguments.index or Path(scratch)
        for cfg in sorted(arguments.folder.glob("*/map.cfg")):
            if cfg.with_name("queries.csv").exists():
                right_px = float(within[cfg.parent.name]) if cfg.parent.name in within else None
                rows += _measure(cfg, arguments, index=index / cfg.parent.name, right_px=right_px)
                if arguments.json:  # after each map, since the whole run takes hours
                    arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")
    print(table("battery", COLUMNS, rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("folder", type=Path, help="holds the maps")
    add("--methods", default="vote,verified,auto", help="names, with commas")
    add("--features", default="SIFT,XFEAT", help="names, with commas")
    add("--limit", type=int, default=0, help="queries a map, evenly spread; 0 for all")
    add("--index", type=Path, help="folder for the indexes, to be used again")
    add("--foreign", type=Path, help="folder of photos from elsewhere")
    add("--baseline", type=Path, action="append", default=[], help="another program; repeatable")
    add("--options", action="append", default=[""], help="further options of the methods; repeatable")
    add("--within", action="append", default=[], metavar="NAME=PX", help="what is right on a map; repeatable")
    add("--json", type=Path, help="write all figures there")
    return parser.parse_args()


def _measure(
    cfg: Path, arguments: argparse.Namespace, *, index: Path, right_px: float | None
) -> list[dict[str, Any]]:
    """Measure all features and methods on one map; `right_px` defaults to its place radius."""
    limited = ["--limit", str(arguments.limit)] if arguments.limit else []
    found = [_baseline(program, cfg, limited) for program in arguments.baseline]
    methods = [m for m in arguments.methods.split(",") if m != AUTO]
    asked = [["--features", f, "--method", m] for f in arguments.features.split(",") for m in methods]
    asked += [["--method", AUTO]] if AUTO in arguments.methods.split(",") else []
    options = [*limited, "--index", str(index)]
    for further in arguments.options:
        for one in asked:
            row = _evaluate(cfg, [*one, *further.split()], options=options, foreign=arguments.foreign)
            found += [{**row, "name": f"{row['name']} {further}".strip()}] if row else []
        # `vote` has no relative poses, by which the kind of a map is detected: use one radius for all methods
        right_px = right_px or found[-1]["place_radius_px"]
    for row in found:
        queries = row.pop("per_query", [])
        errors = [query["error_px"] for query in queries]
        row["refused_though_right"] = refused_though_right(queries, right_px) if "abstained" in row else None
        row["seconds_per_query_mean"] = mean_seconds(queries)
        row["right"] = ratio(sum(e is not None and e <= right_px for e in errors), len(errors))
        row["refused"] = ratio(row["abstained"], row["queries"]) if "abstained" in row else None
    votes = {row["features"]: row["right"] for row in found if row["method"] == "vote"}
    for row in found:
        best = max(votes.values(), default=None) if row["method"] == AUTO else votes.get(row.get("features"))
        row["over_vote"] = None if best is None or row["right"] is None else row["right"] - best
    return found


def _baseline(program: Path, cfg: Path, limited: list[str]) -> dict[str, Any]:
    printed = run(
        [sys.executable, str(program), str(cfg), str(cfg.with_name("queries.csv")), *limited]
    ).printed
    return {**printed, "name": f"{cfg.parent.name} {printed['method']}"}


def _evaluate(
    cfg: Path, asked: list[str], *, options: list[str], foreign: Path | None
) -> dict[str, Any] | None:
    """Measure one configuration; return None, and print why, if an optional part is not installed."""
    program = [sys.executable, "-m", "webapp.app.main"]
    queries = str(cfg.with_name("queries.csv"))
    try:
        done = run([*program, "evaluate", str(cfg), queries, *options, *asked, "--json"])
    except ProgramFailed as error:
        if error.code != MISSING_PART:
            raise
        print(f"{' '.join(asked)} is not measured: {error.messages.strip()}", file=sys.stderr)
        return None
    figures: dict[str, Any] = done.printed
    figures["name"] = f"{cfg.parent.name} {figures['method']} {figures['features']}"
    if foreign is not None:
        photos = [str(path) for path in photos_in(foreign) if cfg.parent not in path.parents]
        localize = [*program, "localize", str(cfg), *photos, *options[-2:], *asked, "--json"]
        figures |= strangers(run(localize, accepted=(0, SOME_FAILED)).printed)
    return figures


if __name__ == "__main__":
    main()
