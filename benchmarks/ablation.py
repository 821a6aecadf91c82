"""Varies one tuning parameter of localization and measures its effect.

    python -m benchmarks.ablation MAP.cfg QUERIES.csv --vary pose.keypoint_sigma_px=1.2,2.4,4.8
        [--features sift] [--index FOLDER] [--limit N] [--fov DEGREES] [--map-fov DEGREES]

Fields are those of `webapp/core/tuning.py`; `--vary` can be repeated, and each field is varied on its own.
Prints a table: share of queries whose most probable place is within each distance, and median error of those
with a place, map pixels. The first row is the default. For fields of `extrinsics` these are estimated again
from the stored pairs, which do not change; `retrieval.pair_...` needs a new index. Probabilities use the
calibration of the default.
"""

from __future__ import annotations

import argparse
import math
import statistics
from dataclasses import replace
from pathlib import Path

from webapp.configuration import load_settings
from webapp.core.tuning import DEFAULT, Tuning, with_field
from webapp.files.localize import queries_csv
from webapp.files.localize.queries_csv import Query
from webapp.progress import Progress
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions

WITHIN_PX = (10.0, 20.0, 50.0, 100.0)


def main() -> None:
    """Measure every value and print the table."""
    arguments = _arguments()
    variants = [("default", DEFAULT)]
    for text in arguments.vary:
        name, _, values = text.partition("=")
        variants += [
            (f"{name}={value}", with_field(DEFAULT, name, text=value)) for value in values.split(",")
        ]
    options = OpenOptions(
        method="verified", features=arguments.features, index=arguments.index, map_fov_deg=arguments.map_fov
    )
    localizer = open_pipeline(
        arguments.map, options, settings=load_settings(), progress=Progress(), fov_deg=arguments.fov
    )
    queries = queries_csv.select(queries_csv.read(arguments.queries), arguments.limit)
    print(f"{'':40s}", *(f"<={w:.0f} px" for w in WITHIN_PX), "median px", sep="  ")
    for name, tuning in variants:
        print(_row(name, errors(tuned(localizer, tuning), queries)), flush=True)


def tuned(localizer: LocalizationPipeline, tuning: Tuning) -> LocalizationPipeline:
    """Return a localizer with another tuning; re-estimate the map's extrinsics if their fields change."""
    opened = localizer.opened
    indexed = replace(opened.indexed, tuning=tuning)
    if tuning.extrinsics != opened.indexed.tuning.extrinsics:
        pairs = orient_map.stored_pairs(opened)
        indexed = replace(indexed, extrinsics=orient_map.estimate(indexed, pairs))
    look = replace(localizer.looks[0], opened=replace(opened, indexed=indexed))
    return replace(localizer, looks=(look,))


def errors(localizer: LocalizationPipeline, queries: list[Query]) -> list[float]:
    """Measure the error of the most probable place of each query, map pixels; infinite without a place."""
    measured = []
    for query in queries:
        answer = localizer.localize(query.path, top=1)
        found = answer.hypotheses[0].position if answer.hypotheses else None
        measured.append(math.inf if found is None else math.dist(found, query.truth))
    return measured


def _row(name: str, measured: list[float]) -> str:
    shares = (sum(e <= within for e in measured) / len(measured) for within in WITHIN_PX)
    finite = [e for e in measured if math.isfinite(e)]
    median = statistics.median(finite) if finite else math.nan
    return "  ".join([f"{name:40s}", *(f"{share:8.3f}" for share in shares), f"{median:8.1f}"])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--vary", action="append", default=[], metavar="FIELD=V1,V2")
    parser.add_argument("--features", default="sift")
    parser.add_argument("--index", type=Path)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--fov", type=float)
    parser.add_argument("--map-fov", type=float)
    return parser.parse_args()


if __name__ == "__main__":
    main()
