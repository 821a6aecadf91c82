"""Measures what reconstructions round the places of a map, made ahead of time, would add to its answers.

    python -m benchmarks.local_reconstructions MAP.cfg QUERIES.csv --work FOLDER [--unit 10] [--count 100]
        [--seed 1] [--fov DEGREES] [--map-fov DEGREES] [--method auto] [--photos 30] [--pieces 1]
        [--agreeing 12,20,40,80]

Queries are chosen at random and localized by --method. A piece is made round each place (position with all
its photos) of the best photos of the first hypothesis, --pieces places at most: its --photos placed photos
start at their positions, with the headings that the map has for them; points are triangulated, and all is
adjusted with the positions as priors. The query's camera is solved from the points of these pieces. The piece
in which most landmarks agree gives the position, if at least --agreeing do, within the map's place radius of
the answer. Prints the shares of queries within 0.5, 1, 2 and 5 units of --unit pixels, without and with
pieces; how far the adjusted cameras of a place are off it together (median); and how far queries of one
position are off it together (root mean square). Features, matches and pieces stay in --work.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.figures import percentile, plain, table
from benchmarks.local_pieces import EXTRACT, At, Piece, PieceMaker
from webapp.configuration import load_settings
from webapp.core.features.types import Features
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import Camera
from webapp.core.landmarks.absolute_pose import Lens, solve_camera
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.files.localize import queries_csv
from webapp.files.localize.queries_csv import Query
from webapp.progress import Progress
from webapp.settings import restrain_threads
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.query_photo import read_query

SIFT = "sift"
"""The features of pieces, which the index that finds the photos needs to have, too."""

LIMITS = (0.5, 1.0, 2.0, 5.0)
"""Error limits of the shares that are printed, in units."""

_COMMON_WITHIN = 2.0
"""Errors of queries up to this many units tell how accurate the true positions are; larger ones are wrong."""

COLUMNS = {
    **{f"{limit:g}": plain(f"within_{limit:g}") for limit in LIMITS},
    "by pieces": plain("taken", 0),
    "their median without": plain("median_without", 2),
    "with": plain("median_with", 2),
}


class Solved(NamedTuple):
    """Position of a query by a piece, and the number of landmarks that agree on it."""

    position: At
    landmarks: int


@dataclass(frozen=True, slots=True)
class Measured:
    """A query's answer, None without a place, and its position by the best piece, None without one."""

    truth: At
    answer: At | None
    piece: Solved | None

    def position(self, agreeing: float, *, place_radius_px: float) -> At | None:
        """Return the position by the piece if enough landmarks agree near the answer, else the answer."""
        if self.answer is None or self.piece is None or self.piece.landmarks < agreeing:
            return self.answer
        is_near = math.dist(self.answer, self.piece.position) <= place_radius_px
        return self.piece.position if is_near else self.answer


class Localizer:
    """Localizes queries by a method, and by the pieces round their best photos."""

    def __init__(self, pipeline: LocalizationPipeline, maker: PieceMaker, *, pieces: int) -> None:
        self._pipeline, self._maker, self._pieces = pipeline, maker, pieces
        opened = pipeline.looks[0].opened
        detailed = replace(opened, settings=replace(opened.settings, extract=EXTRACT))
        self._look = replace(pipeline.looks[0], opened=detailed)
        self.used: dict[At, Piece] = {}

    def measure(self, query: Query) -> Measured:
        """Localize one query."""
        found = self._pipeline.localize(query.path, top=1).hypotheses
        if not found:
            return Measured(query.truth, None, None)
        places = [*dict.fromkeys(self._maker.place_of(id) for id in found[0].experiences)][: self._pieces]
        settings, fov_deg = self._look.opened.settings, self._pipeline.fov_deg
        photo = read_query(query.path, settings=settings, fov_deg=fov_deg, describe=None)[0]
        features, solved = self._look.extract(photo), []
        for place in places:
            if place not in self.used:
                self.used[place] = self._maker.around(place)
            cloud = self.used[place].cloud
            lenses = _lenses(cloud, features, degrees=photo.fov.degrees, sigma=photo.fov.focal_sigma)
            pose = solve_camera(features, cloud, rows=np.arange(len(cloud.seen_point)), lenses=lenses).pose
            if not isinstance(pose, NoPose):
                x, y, _ = pose.centre.tolist()
                solved.append(Solved((x, y), int(pose.inlier.sum())))
        return Measured(
            query.truth, found[0].position, max(solved, key=lambda one: one.landmarks, default=None)
        )


def _lenses(cloud: LandmarkCloud, query: Features, *, degrees: float, sigma: float) -> list[Lens]:
    """List the query's lens as stated, and as the piece has it for the map's photos."""
    size = query.photo_size
    stated = Lens(*size, Camera(*size, degrees).focal_px, focal_sigma=sigma)
    known = cloud.focal_px > 0.0
    if not known.any():
        return [stated]
    focal_px, distortion = (float(np.median(one[known])) for one in (cloud.focal_px, cloud.distortion))
    return [stated, Lens(*size, focal_px, distortion, focal_sigma=sigma)]


def shares(
    measured: Sequence[Measured], agreeing: float, *, unit: float, place_radius_px: float
) -> dict[str, float | None]:
    """Return the shares of queries within each limit, where pieces answer from `agreeing` landmarks on."""
    at = [one.position(agreeing, place_radius_px=place_radius_px) for one in measured]
    error = [_error(one.truth, there) / unit for one, there in zip(measured, at, strict=True)]
    taken = [n for n, one in enumerate(measured) if at[n] is not one.answer]
    return {
        **{f"within_{limit:g}": float(np.mean(np.array(error) <= limit)) for limit in LIMITS},
        "taken": len(taken),
        "median_without": percentile(
            [_error(measured[n].truth, measured[n].answer) / unit for n in taken], 50
        ),
        "median_with": percentile([error[n] for n in taken], 50),
    }


def _error(truth: At, at: At | None) -> float:
    return math.inf if at is None else math.dist(truth, at)


def common_error(measured: Sequence[Measured], agreeing: float, *, within: float) -> float | None:
    """Estimate the error (RMS) that queries of one true position have in common; None without two of them.

    For errors that have nothing else in common, the mean of their inner products is its square.
    """
    errors: dict[At, list[complex]] = {}
    for one in measured:
        if one.piece is not None and one.piece.landmarks >= agreeing:
            off = complex(*one.piece.position) - complex(*one.truth)
            if abs(off) <= within:
                errors.setdefault(one.truth, []).append(off)
    products = [(a * b.conjugate()).real for some in errors.values() for a, b in combinations(some, 2)]
    return math.sqrt(max(float(np.mean(products)), 0.0)) if products else None


def main() -> None:
    """Measure as the command line asks."""
    given = _arguments()
    restrain_threads()
    features = "auto" if given.method == "auto" else SIFT
    options = OpenOptions(method=given.method, features=features, map_fov_deg=given.map_fov)
    settings = load_settings()
    pipeline = open_pipeline(given.map, options, settings=settings, progress=Progress(), fov_deg=given.fov)
    if pipeline.features != SIFT:
        raise SystemExit(f"the first look has {pipeline.features}, pieces need {SIFT}: remove its index")
    queries = queries_csv.read(given.queries)
    queries = random.Random(given.seed).sample(queries, min(given.count, len(queries)))
    maker = PieceMaker(pipeline.looks[0].opened, given.work, photos=given.photos)
    localizer = Localizer(pipeline, maker, pieces=given.pieces)
    started = time.process_time()
    measured = [localizer.measure(query) for query in queries]
    limits = [math.inf, *map(float, given.agreeing.split(","))]
    radius = pipeline.place_radius_px
    rows = [
        {
            "name": given.method if math.isinf(limit) else f"pieces from {limit:g} landmarks on",
            **shares(measured, limit, unit=given.unit, place_radius_px=radius),
        }
        for limit in limits
    ]
    print(table(f"{len(queries)} queries, {len(localizer.used)} pieces", COLUMNS, rows))
    off = [piece.off_px / given.unit for piece in localizer.used.values() if math.isfinite(piece.off_px)]
    common = common_error(measured, min(limits), within=_COMMON_WITHIN * given.unit)
    figures = {
        "map_places_off_p50": percentile(off, 50),
        "queries_of_a_place_off_together": None if common is None else common / given.unit,
        "processor_s": time.process_time() - started,
    }
    print(json.dumps({name: value and round(value, 2) for name, value in figures.items()}))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("map", type=Path)
    add("queries", type=Path)
    add("--work", type=Path, required=True, help="folder for features, matches and pieces, used again")
    add("--unit", type=float, default=1.0, help="pixels")
    add("--count", type=int, default=100, help="queries")
    add("--seed", type=int, default=1)
    add("--fov", type=float, help="horizontal field of view of the queries, degrees")
    add("--map-fov", type=float, help="that of the map's photos")
    add("--method", default="auto")
    add("--photos", type=int, default=30, help="of a piece")
    add("--pieces", type=int, default=1, help="that a query is compared with")
    add("--agreeing", default="12,20,40,80", help="landmarks, with commas")
    return parser.parse_args()


if __name__ == "__main__":
    main()
