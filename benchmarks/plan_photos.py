"""Measures the benefit of a photo plan: places of a map are hidden, and some are restored as planned.

    python -m benchmarks.plan_photos MAP.cfg QUERIES.csv [--keep 0.25] [--spots 12] [--seeds 3]
        [--limit N] [--index FOLDER] [--uneven]

Of the map's places (positions with all their photos) a share stays; with `--uneven` most of them in one half
of the map. A trial is run for each photo that stays, hidden from the index, and spots are planned from the
results. The hidden place nearest to each spot is restored with all its photos, as if somebody had taken
photos in all directions there. For comparison as many places are restored at random, by farthest-point
sampling, and by a plan without trials. Prints a line of JSON for each seed, with the share of the queries
whose first answer is within the place radius of the whole map.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.configuration import load_settings
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.places import place_radius_px
from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.photo_plan import plan_spots
from webapp.core.mapmodel.recognition import PhotoTrials, Rectangle, estimate_recognition
from webapp.errors import PhotoError
from webapp.files.localize import queries_csv
from webapp.progress import Progress
from webapp.settings import restrain_threads
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.photo_plan import PhotoTrial

Places = Mapping[MapPixel, Sequence[int]]

TOP = 5
_SPARSE = 0.2
"""Share of the places that stay that is in the other half of an uneven map."""


def places_of(map_: Map) -> Places:
    """Return the ids of the photos at each position."""
    places: dict[MapPixel, list[int]] = defaultdict(list)
    for e in map_.experiences:
        places[e.position].append(e.id)
    return places


def split(places: Places, *, keep: float, uneven: bool, seed: int) -> tuple[list[MapPixel], list[MapPixel]]:
    """Choose the places that stay; return them and the hidden ones."""
    rng = np.random.default_rng(seed)
    every = sorted(places)
    weight = np.ones(len(every))
    if uneven:
        x = np.array([place.x for place in every])
        weight[x > np.median(x)] = _SPARSE / (1.0 - _SPARSE)
    count = round(keep * len(every))
    stay = set(rng.choice(len(every), count, replace=False, p=weight / weight.sum()).tolist())
    return [p for n, p in enumerate(every) if n in stay], [p for n, p in enumerate(every) if n not in stay]


def nearest_to(spots: Sequence[tuple[float, float]], hidden: Sequence[MapPixel]) -> list[MapPixel]:
    """Return the nearest hidden place of each spot, each place once."""
    left = list(hidden)
    taken = []
    for spot in spots:
        best = min(left, key=lambda place: float(np.hypot(*np.subtract(place, spot))))
        left.remove(best)
        taken.append(best)
    return taken


def farthest(there: Sequence[MapPixel], hidden: Sequence[MapPixel], count: int) -> list[MapPixel]:
    """Choose hidden places by farthest-point sampling, starting from those that are there."""
    candidates, taken = np.array(hidden), []
    away = distances(candidates, np.array(there)).min(axis=1)
    for _ in range(count):
        best = int(away.argmax())
        taken.append(hidden[best])
        away = np.minimum(away, distances(candidates, candidates[[best]])[:, 0])
    return taken


def distances(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each point of the first to each of the second."""
    return np.asarray(np.hypot(*(first[:, None, :] - second[None, :, :]).transpose(2, 0, 1)))


def planned(
    left: Map, trials: Mapping[int, PhotoTrial], *, places: Places, count: int
) -> list[tuple[float, float]]:
    """Plan spots near any of the places, which are known to be walkable, instead of a hand-drawn area."""
    width, height = left.satellite.width, left.satellite.height
    image = Rectangle(0.0, 0.0, width, height)
    rows = [
        (*e.position, trial.success, math.nan if trial.heading_deg is None else trial.heading_deg)
        for e in left.experiences
        for trial in [trials.get(e.id, PhotoTrial(math.nan))]
    ]
    table = np.array(rows, np.float64)
    photos = PhotoTrials(table[:, :2], table[:, 3], table[:, 2])
    radius = place_radius_px(table[:, :2], width=width, height=height)
    grid = estimate_recognition(photos, radius=radius, image=image, area=image)
    walkable = distances(grid.cell, np.array([*places])).min(axis=1) <= radius / 2.0
    spots = plan_spots(replace(grid, wanted=walkable), photos, count=count)
    return [spot.position for spot in spots]


def ids_at(places: Places, chosen: Collection[MapPixel]) -> set[int]:
    """Return the ids of the photos at some places."""
    return {id for place in chosen for id in places[place]}


class Bench:
    """A map whose photos can be hidden."""

    def __init__(self, pipeline: LocalizationPipeline, folder: Path) -> None:
        self.pipeline = with_hidden_photos(pipeline)
        self.map, self.folder = pipeline.map, folder
        self.radius = pipeline.place_radius_px

    def trials(self, stay: Collection[int]) -> dict[int, PhotoTrial]:
        """Localize each photo that stays on the map of the others that stay."""
        gone = {e.id for e in self.map.experiences} - set(stay)
        return {
            e.id: self._look(self.folder / e.photo, e.position, hide=frozenset(gone | {e.id}))
            for e in self.map.experiences
            if e.id in stay
        }

    def recognised(self, queries: Sequence[queries_csv.Query], stay: Collection[int]) -> float:
        """Return the share of queries that are localized correctly on a map of some photos."""
        gone = frozenset({e.id for e in self.map.experiences} - set(stay))
        return float(np.mean([self._look(q.path, q.truth, hide=gone).success for q in queries]))

    def _look(self, photo: Path, truth: MapPixel, *, hide: frozenset[int]) -> PhotoTrial:
        try:
            answer = self.pipeline.localize(photo, top=TOP, hide=hide)
        except PhotoError:
            return PhotoTrial(0.0)
        first = next(iter(answer.hypotheses), None)
        if first is None or float(np.hypot(*np.subtract(first.position, truth))) > self.radius:
            return PhotoTrial(0.0)
        return PhotoTrial(1.0, first.heading_deg)


def measure(
    bench: Bench, queries: Sequence[queries_csv.Query], options: argparse.Namespace
) -> Iterator[dict[str, object]]:
    """Compare the strategies of choosing places, once per seed."""
    places = places_of(bench.map)
    for seed in range(options.seeds):
        stay, hidden = split(places, keep=options.keep, uneven=options.uneven, seed=seed)
        there = ids_at(places, stay)
        left = replace(
            bench.map, experiences=tuple(e for e in bench.map.experiences if e.id in there), placements=()
        )
        trials = bench.trials(there)
        count = options.spots
        spots = planned(left, trials, places=places, count=count)
        by_density = planned(left, {}, places=places, count=count)
        rng = np.random.default_rng(1000 + seed)
        ways = {
            "none": [],
            "plan": nearest_to(spots, hidden),
            "plan_without_trials": nearest_to(by_density, hidden),
            "random": [hidden[n] for n in rng.choice(len(hidden), count, replace=False)],
            "farthest": farthest(stay, hidden, count),
            "all": hidden,
        }
        yield {
            "seed": seed,
            "places": len(stay),
            "added": count,
            "trials_recognised": round(float(np.mean([t.success for t in trials.values()])), 3),
            "recognised": {
                way: round(bench.recognised(queries, there | ids_at(places, chosen)), 3)
                for way, chosen in ways.items()
            },
        }


def main() -> None:
    """Run as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--keep", type=float, default=0.25, help="share of the places")
    parser.add_argument("--uneven", action="store_true")
    parser.add_argument("--spots", type=int, default=12)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--limit", type=int, help="number of queries, evenly spread")
    parser.add_argument("--index", type=Path)
    options = parser.parse_args()
    restrain_threads()
    pipeline = open_pipeline(
        options.map,
        OpenOptions(method="verified", features="sift", index=options.index),
        settings=load_settings(),
        progress=Progress(),
    )
    bench = Bench(pipeline, options.map.parent)
    queries = queries_csv.select(queries_csv.read(options.queries), options.limit)
    for figures in measure(bench, queries, options):
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
