"""Measures the calibration of probabilities on maps that were not used to fit the defaults.

    python -m benchmarks.held_out FOLDER [--features sift,xfeat] [--limit N] [--index FOLDER]
        [--foreign FOLDER] [--within NAME=PX ...] [--json OUT]

FOLDER holds maps, each a folder with `map.cfg` and `queries.csv`, as for `benchmarks.battery`; an index in
the --index folder is reused. For each map the default coefficients of the calibration are fitted on the
queries of all other maps, with equal weight for each map, and its own calibration, on its photos, is
regularised towards these. Columns, for each map and features: share of right first answers and calibration
error (ECE), with the program's defaults, which were fitted on all of these maps, and with the held-out ones;
each after calibration on the map's own photos and, "uncalibrated", without it. "but right" is the share of
queries that are "not on this map" though the first place is right, "off" the median of "not on this map" of
the --foreign photos.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import percentile, plain, table
from benchmarks.side_by_side import photos_in
from webapp.configuration import load_settings
from webapp.core.evaluation.metrics import expected_calibration_error
from webapp.core.hypotheses.calibration import DEFAULT, Calibration, Case, fit, probabilities
from webapp.core.localize.verified import find_places, locate
from webapp.files.localize import queries_csv
from webapp.progress import Progress
from webapp.tasks.localize import calibrate
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.trials import Trial

_AWAY = 0.2
"""Weight of a photo from elsewhere, as in the calibration of a map."""

COLUMNS = {
    "queries": plain("queries", 0),
    "right": plain("right"),
    "ECE": plain("ece"),
    "but right": plain("refused_though_right", 2),
    "off": plain("foreign_off_map_p50", 2),
    "held out: right": plain("held_out_right"),
    "held out: ECE": plain("held_out_ece"),
    "held out: but right": plain("held_out_refused_though_right", 2),
    "held out: off": plain("held_out_foreign_off_map_p50", 2),
    "uncalibrated: ECE": plain("uncalibrated_ece"),
    "held out and uncalibrated: ECE": plain("held_out_uncalibrated_ece"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Results for the queries of a map, for foreign photos, and for trials of its own photos."""

    name: str
    pipeline: LocalizationPipeline
    queries: list[Case]
    foreign: list[Case]
    trials: list[Trial]

    def calibrated(self, start: Calibration) -> Calibration:
        """Fit the calibration on the map's own photos, regularised towards `start`."""
        return calibrate.fit_trials(self.pipeline.opened.indexed, self.trials, start=start)


def main() -> None:
    """Measure all maps and print the table."""
    arguments = _arguments()
    within = dict(pair.split("=", 1) for pair in arguments.within)
    rows: list[dict[str, Any]] = []
    for features in arguments.features.split(","):
        maps = [
            _measure(cfg, features, arguments, within=within)
            for cfg in sorted(arguments.folder.glob("*/map.cfg"))
            if cfg.with_name("queries.csv").exists()
        ]
        rows += [_row(one, [other for other in maps if other is not one]) for one in maps]
    print(table("each map held out", COLUMNS, rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("folder", type=Path, help="holds the maps")
    add("--features", default="sift,xfeat", help="names, with commas")
    add("--limit", type=int, default=0, help="queries a map, evenly spread; 0 for all")
    add("--index", type=Path, help="folder for the indexes, to be used again")
    add("--foreign", type=Path, help="folder of photos from elsewhere")
    add("--within", action="append", default=[], metavar="NAME=PX", help="what is right on a map; repeatable")
    add("--json", type=Path, help="write all figures there")
    return parser.parse_args()


def _measure(cfg: Path, features: str, arguments: argparse.Namespace, *, within: dict[str, str]) -> Measured:
    index = arguments.index / cfg.parent.name if arguments.index else None
    right_px = float(within[cfg.parent.name]) if cfg.parent.name in within else None
    options = OpenOptions(method="verified", features=features, index=index, right_within_px=right_px)
    progress = Progress()
    pipeline = open_pipeline(cfg, options, settings=load_settings(), progress=progress)
    queries = queries_csv.select(queries_csv.read(cfg.with_name("queries.csv")), arguments.limit or None)
    away = photos_in(arguments.foreign) if arguments.foreign else []
    trials = calibrate.run_trials(pipeline.opened, progress=progress)
    return Measured(
        f"{cfg.parent.name} {features}",
        pipeline,
        [_case(pipeline, query.path, query.truth) for query in queries],
        [_case(pipeline, path, None) for path in away if cfg.parent not in path.parents],
        [*trials.values()],
    )


def _case(pipeline: LocalizationPipeline, path: Path, truth: Sequence[float] | None) -> Case:
    """Find places for a photo, and mark those within the place radius of the truth, or none without it."""
    indexed = pipeline.opened.indexed
    photo, *_ = pipeline._read(path)  # internal steps, since answers have no evidence vectors
    found = find_places(indexed, pipeline.looks[0].extract(photo), fov_deg=photo.fov.degrees)
    radius = indexed.place_radius_px
    known = pipeline.looks[0].calibration
    stored = DEFAULT if known is None else known.calibration
    at = [locate(p, calibration=stored, place_radius_px=radius).position for p in found.places]
    right = [truth is not None and math.dist(a, truth) <= radius for a in at]
    return Case(found.evidence, np.array(right, np.bool_), _AWAY if truth is None else 1.0)


def _row(one: Measured, others: Sequence[Measured]) -> dict[str, Any]:
    held_out = _defaults(others)
    calibrated = [one.calibrated(start) for start in (DEFAULT, held_out)]
    shipped, fitted = (_figures(one.queries, calibration) for calibration in calibrated)
    refused = [_refused_though_right(one.queries, calibration) for calibration in calibrated]
    off = [percentile(_off_map(one.foreign, calibration), 50) for calibration in calibrated]
    plainly, alone = (_figures(one.queries, start) for start in (DEFAULT, held_out))
    return {
        "name": one.name,
        "queries": len(one.queries),
        "right": shipped[0],
        "ece": shipped[1],
        "refused_though_right": refused[0],
        "held_out_refused_though_right": refused[1],
        "foreign_off_map_p50": off[0],
        "held_out_foreign_off_map_p50": off[1],
        "held_out_right": fitted[0],
        "held_out_ece": fitted[1],
        "uncalibrated_ece": plainly[1],
        "held_out_uncalibrated_ece": alone[1],
    }


def _defaults(maps: Sequence[Measured]) -> Calibration:
    """Fit the coefficients on the queries of maps, with equal weight for each map."""
    mean = float(np.mean([len(m.queries) for m in maps]))
    cases = [
        replace(case, weight=case.weight * mean / len(m.queries))
        for m in maps
        for case in (*m.queries, *m.foreign)
    ]
    # regularised towards zero, so that nothing fitted on the held-out map leaks in
    nothing = replace(DEFAULT, slope=(0.0,) * len(DEFAULT.slope), offset=0.0)
    slope, offset = fit(cases, start=nothing)
    return replace(DEFAULT, slope=slope, offset=offset)


def _figures(cases: Sequence[Case], calibration: Calibration) -> tuple[float, float | None]:
    """Return the share of right first answers, and the calibration error."""
    stated, happened = [], []
    for case in cases:
        place, _ = probabilities(case.evidence, calibration)
        first = int(place.argmax()) if len(place) else None
        stated.append(0.0 if first is None else float(place[first]))
        happened.append(first is not None and bool(case.right[first]))
    return float(np.mean(happened)), expected_calibration_error(stated, happened)


def _refused_though_right(cases: Sequence[Case], calibration: Calibration) -> float:
    """Return the share of cases in which "not on this map" leads, but the first place is right."""
    refused = 0
    for case in cases:
        place, off = probabilities(case.evidence, calibration)
        refused += bool(len(place) and off > place.max() and case.right[int(place.argmax())])
    return refused / len(cases)


def _off_map(cases: Sequence[Case], calibration: Calibration) -> list[float]:
    return [probabilities(case.evidence, calibration)[1] for case in cases]


if __name__ == "__main__":
    main()
