"""Measures the gain from more information than one photo: hints, several photos of a spot, a sequence.

Queries with the same truth are photos of one spot. If all truths differ, the queries must be the frames of a
walk, in order: then each frame with its neighbours counts as photos of one spot, the direction of the walk
serves as compass heading, and the sequence is measured. Hints are derived from the truth: a circle whose
centre is off by up to half its radius, and a compass with noise. Wrong hints are measured, too: circles of
other queries, and opposite headings. Photos from elsewhere, treated as the frames of a walk, must stay
uncertain.

    python -m benchmarks.hints_and_sequences MAP.cfg QUERIES.csv [--features sift] [--first N]
        [--foreign FOLDER] [--json OUT]
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from webapp.configuration import load_settings
from webapp.core.evaluation.metrics import QueryResult, summarise
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.priors import CirclePrior, apply_path_prior_to_answer
from webapp.core.hypotheses.sequence import Belief, filter_step, smooth
from webapp.files.localize.queries_csv import Query, read
from webapp.progress import Progress
from webapp.tasks.localize import spot as localize_spot
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.sequence import motion
from webapp.tasks.localize.spot import Hints

TOP = 5
HINT_RADII, COMPASS_NOISE_DEG = 3.0, 15.0
"""Radius of the circles, in place radii of the map; noise of the compass."""

OF_ONE_SPOT = 3
REACH = 3
"""Number of frames before and after from which the direction of the walk is computed."""

CERTAIN = 0.9
"""A wrong answer with at least this probability counts as confidently wrong."""

COLUMNS = (
    "within_10px",
    "within_20px",
    "within_50px",
    "median_px",
    "ece",
    "answered_at_99",
    "radius_coverage",
    "surely_wrong",
)


def main() -> None:
    """Measure all variants and print the table."""
    arguments = _parser().parse_args()
    localizer = open_pipeline(
        arguments.map,
        OpenOptions(method="verified", features=arguments.features, jobs=1, map_fov_deg=arguments.map_fov),
        settings=load_settings(),
        progress=Progress(),
        fov_deg=arguments.fov,
    )
    queries = read(arguments.queries)[: arguments.first]
    rows = {
        name: _figures(asked, answers, localizer)
        for name, (asked, answers) in _ways(localizer, queries).items()
    }
    print(f"{'':<26}" + "".join(f"{column:>17}" for column in COLUMNS))
    for name, figures in rows.items():
        print(f"{name:<26}" + "".join(f"{figures[column]:>17.3f}" for column in COLUMNS))
    if arguments.foreign:
        rows |= _foreign(localizer, sorted(arguments.foreign.iterdir())[: arguments.first])
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--features", default="auto")
    parser.add_argument("--fov", type=float, help="of the queries, degrees")
    parser.add_argument("--map-fov", type=float, help="of map photos without one in their EXIF, degrees")
    parser.add_argument("--first", type=int, help="only so many of the queries")
    parser.add_argument("--foreign", type=Path, help="photos from elsewhere, frames of a walk by their names")
    parser.add_argument("--json", type=Path, help="write all figures there")
    return parser


def _ways(
    localizer: LocalizationPipeline, queries: Sequence[Query]
) -> dict[str, tuple[Sequence[Query], list[Answer]]]:
    """Localize with each kind of information; return the queries and answers of each."""
    rng = np.random.default_rng(0)
    paths = localizer.opened.indexed.paths
    truths = [q.truth for q in queries]
    walk = len(set(truths)) == len(truths)
    circles = [Hints(_circle(t, HINT_RADII * localizer.place_radius_px, rng)) for t in truths]
    shown = _directions(truths) + rng.normal(0.0, COMPASS_NOISE_DEG, len(queries))
    compass = [Hints(heading_deg=float(degrees)) for degrees in shown]
    alone = _look(localizer, queries, [Hints()] * len(queries), name="single photos")
    elsewhere = [circles[(i + len(queries) // 2) % len(queries)] for i in range(len(queries))]
    turned = [Hints(heading_deg=float(degrees) + 180.0) for degrees in shown]

    def hinted(looks: Sequence[Answer], hints: Sequence[Hints]) -> tuple[Sequence[Query], list[Answer]]:
        pairs = zip(looks, hints, strict=True)
        return queries, [localize_spot.combine(localizer, [a], hints=h, top=TOP)[0] for a, h in pairs]

    ways = {
        "single photos, by itself": (queries, alone),
        "single photos": (queries, [apply_path_prior_to_answer(answer, paths) for answer in alone]),
        "position hint": hinted(_look(localizer, queries, circles, name="position hint"), circles),
        "wrong position hint": hinted(
            _look(localizer, queries, elsewhere, name="wrong position hint"), elsewhere
        ),
        **_spots(localizer, queries, alone, walk=walk),
    }
    if walk:
        ways["compass hint"], ways["wrong compass hint"] = hinted(alone, compass), hinted(alone, turned)
        ways["sequence"] = (queries, _followed(localizer, alone))
        ways["sequence, smoothed"] = (queries, smooth(alone, motion=motion(localizer), top=TOP))
    return ways


def _look(
    localizer: LocalizationPipeline, queries: Sequence[Query], hints: Sequence[Hints], *, name: str
) -> list[Answer]:
    print(name, file=sys.stderr, flush=True)
    pairs = zip(queries, hints, strict=True)
    answers = []
    for query, hint in pairs:
        include = localize_spot.photos_in(localizer, hint.near)
        answer = localizer.observe(query.path, top=localize_spot.ALL, include=include)
        answers.append(replace(answer, evidence=()))
    return answers


def _foreign(localizer: LocalizationPipeline, photos: Sequence[Path]) -> dict[str, dict[str, float]]:
    """Print figures for photos from elsewhere, as single photos and as a walk."""
    queries = [Query(photo.name, photo, MapPixel(math.nan, math.nan)) for photo in photos]
    alone = _look(localizer, queries, [Hints()] * len(queries), name="from elsewhere")
    ways = {
        "single photos": alone,
        "sequence": _followed(localizer, alone),
        "sequence, smoothed": smooth(alone, motion=motion(localizer), top=TOP),
    }
    rows = {f"from elsewhere, {name}": _uncertainty(answers) for name, answers in ways.items()}
    for name, figures in rows.items():
        print(f"{name:<40}" + "".join(f"{column} {value:.2f}   " for column, value in figures.items()))
    return rows


def _uncertainty(answers: Sequence[Answer]) -> dict[str, float]:
    off = np.array([answer.off_map_probability or 0.0 for answer in answers])
    first = np.array([h.probability for answer in answers for h in answer.hypotheses[:1]] or [0.0])
    return {
        "not_on_map_mean": float(off.mean()),
        "not_on_map_last": float(off[-1]),
        "first_mean": float(first.mean()),
        "first_most": float(first.max()),
        "placed": float((first >= 0.5).sum() / len(answers)),
    }


def _followed(localizer: LocalizationPipeline, alone: Sequence[Answer]) -> list[Answer]:
    belief, followed = Belief(), []
    how = motion(localizer)
    for answer in alone:
        belief, joined = filter_step(belief, answer, motion=how, top=TOP)
        followed.append(joined)
    return followed


def _circle(truth: MapPixel, radius: float, rng: np.random.Generator) -> CirclePrior:
    """Return a circle that contains the truth; its centre is off by up to half its radius."""
    way, angle = radius / 2.0 * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
    return CirclePrior(truth.x + way * math.cos(angle), truth.y + way * math.sin(angle), radius)


def _spots(
    localizer: LocalizationPipeline, queries: Sequence[Query], answers: Sequence[Answer], *, walk: bool
) -> dict[str, tuple[Sequence[Query], list[Answer]]]:
    """Combine the answers for photos of one spot; for a walk, each with those of its neighbours."""
    count, half = len(queries), OF_ONE_SPOT // 2
    if walk:
        spots = [list(range(max(i - half, 0), min(i + half + 1, count))) for i in range(count)]
        asked: list[Query] = list(queries)
    else:
        truths = dict.fromkeys(q.truth for q in queries)
        spots = [[i for i, q in enumerate(queries) if q.truth == truth] for truth in truths]
        asked = [queries[spot[0]] for spot in spots]
    photos = max(len(spot) for spot in spots)
    joined = [
        localize_spot.combine(localizer, [answers[i] for i in spot], hints=Hints(), top=TOP)[0]
        for spot in spots
    ]
    return {f"{photos} photos of one spot": (asked, joined)}


def _directions(truths: Sequence[MapPixel]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the direction of the walk at each frame, degrees clockwise from up."""
    directions = []
    for i in range(len(truths)):
        a, b = truths[max(i - REACH, 0)], truths[min(i + REACH, len(truths) - 1)]
        directions.append(math.degrees(math.atan2(b.x - a.x, a.y - b.y)))
    return np.array(directions)


def _figures(
    queries: Sequence[Query], answers: Sequence[Answer], localizer: LocalizationPipeline
) -> dict[str, float]:
    results = [QueryResult(q.name, q.truth, a) for q, a in zip(queries, answers, strict=True)]
    rng = np.random.default_rng(0)
    summary = summarise(results, place_radius_px=localizer.place_radius_px, rng=rng)
    values = {
        **{f"within_{radius}px": summary.within[radius] for radius in (10, 20, 50)},
        "median_px": summary.median_px,
        "ece": summary.ece,
        "answered_at_99": summary.answered_at_99_precision,
        "radius_coverage": summary.radius_coverage,
        "surely_wrong": float(np.mean([_surely_wrong(r, localizer.place_radius_px) for r in results])),
    }
    return {name: math.nan if value is None else value for name, value in values.items()}


def _surely_wrong(result: QueryResult, radius: float) -> bool:
    answer, error = result.answer, result.error_px
    if answer is None or error is None:
        return False
    return answer.hypotheses[0].probability >= CERTAIN and error > radius


if __name__ == "__main__":
    main()
