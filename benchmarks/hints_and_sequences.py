"""Measures what is gained by knowing more than one photo: hints, several photos of a spot, a sequence.

The queries must be the frames of a walk, in their order. Hints are made from the truth: a circle whose middle
is off by noise, and a compass that shows the direction of the walk with noise.

    python benchmarks/hints_and_sequences.py MAP.cfg QUERIES.csv [--features sift] [--first N] [--json OUT]
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from webapp.core.evaluation.summary import summarise
from webapp.core.evaluation.types import QueryResult
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses import joint
from webapp.core.hypotheses.compass import with_heading
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.sequence import Belief, follow
from webapp.files.queries_csv import Query, read
from webapp.progress import Progress
from webapp.settings import from_environment
from webapp.tasks import prepare
from webapp.tasks.localize_photo import PhotoLocalizer
from webapp.tasks.localize_sequence import FRAME_TOP, motion
from webapp.tasks.localize_upload import Near, Question, hidden
from webapp.tasks.open_map import OpenOptions

TOP = 5
HINT_RADIUS_PX, COMPASS_NOISE_DEG = 60.0, 15.0
OF_ONE_SPOT = 3
REACH = 3
"""Frames before and after that the direction of the walk is taken from."""

COLUMNS = (
    "within_10px",
    "within_20px",
    "within_50px",
    "median_px",
    "ece",
    "answered_at_99",
    "radius_coverage",
)


def main() -> None:
    """Measure each and print the table."""
    arguments = _parser().parse_args()
    localizer = prepare.run(
        arguments.map,
        OpenOptions(features=arguments.features, jobs=1),
        settings=from_environment(),
        progress=Progress(),
        fov_deg=arguments.fov,
    )
    queries = read(arguments.queries)[: arguments.first]
    rows = {
        name: _figures(queries, answers, localizer) for name, answers in _ways(localizer, queries).items()
    }
    print(f"{'':<24}" + "".join(f"{column:>17}" for column in COLUMNS))
    for name, figures in rows.items():
        print(f"{name:<24}" + "".join(f"{figures[column]:>17.3f}" for column in COLUMNS))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--features", default="auto")
    parser.add_argument("--fov", type=float, help="of the queries, degrees")
    parser.add_argument("--first", type=int, help="only so many of the queries")
    parser.add_argument("--json", type=Path, help="write all figures there")
    return parser


def _ways(localizer: PhotoLocalizer, queries: Sequence[Query]) -> dict[str, list[Answer]]:
    rng = np.random.default_rng(0)
    circles = [_circle(q.truth, rng) for q in queries]
    compass = _directions([q.truth for q in queries]) + rng.normal(0.0, COMPASS_NOISE_DEG, len(queries))
    alone = _ask(localizer, queries, lambda _: Question(()), name="single photos")
    near = _ask(localizer, queries, lambda i: Question((), near=circles[i]), name="position hint")
    turned = _ask(
        localizer, queries, lambda i: Question((), heading_deg=float(compass[i])), name="compass hint"
    )
    belief, followed = Belief(), []
    how = motion(localizer)
    for answer in alone:
        belief, joined = follow(belief, answer, motion=how, top=TOP)
        followed.append(joined)
    return {
        "single photos": alone,
        "position hint": near,
        "compass hint": turned,
        f"{OF_ONE_SPOT} photos of one spot": _spots(alone, localizer.place_radius_px),
        "sequence": followed,
    }


def _ask(
    localizer: PhotoLocalizer, queries: Sequence[Query], question: Callable[[int], Question], *, name: str
) -> list[Answer]:
    print(name, file=sys.stderr, flush=True)
    answers = []
    for number, query in enumerate(queries):
        asked = question(number)
        answer = localizer.localize(query.path, top=FRAME_TOP, hide=hidden(localizer, asked))
        if asked.heading_deg is not None:
            answer = with_heading(answer, asked.heading_deg)
        answers.append(replace(answer, evidence=()))
    return answers


def _circle(truth: MapPixel, rng: np.random.Generator) -> Near:
    """A circle that holds the truth; its middle is off by up to half its radius."""
    way, angle = HINT_RADIUS_PX / 2.0 * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
    return Near(truth.x + way * math.cos(angle), truth.y + way * math.sin(angle), HINT_RADIUS_PX)


def _spots(answers: Sequence[Answer], radius: float) -> list[Answer]:
    """Join each answer with those of its neighbours."""
    half = OF_ONE_SPOT // 2
    return [
        joint.join(answers[max(i - half, 0) : i + half + 1], place_radius_px=radius, top=TOP)
        for i in range(len(answers))
    ]


def _directions(truths: Sequence[MapPixel]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Directions of the walk at each frame, degrees clockwise from up."""
    directions = []
    for i in range(len(truths)):
        a, b = truths[max(i - REACH, 0)], truths[min(i + REACH, len(truths) - 1)]
        directions.append(math.degrees(math.atan2(b.x - a.x, a.y - b.y)))
    return np.array(directions)


def _figures(
    queries: Sequence[Query], answers: Sequence[Answer], localizer: PhotoLocalizer
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
    }
    return {name: math.nan if value is None else value for name, value in values.items()}


if __name__ == "__main__":
    main()
