"""Measures the landmark cloud of a map whose photos are all placed, and its gain for localization.

    python -m benchmarks.placed_cloud MAP.cfg [--unit 10] [--queries QUERIES.csv] [--limit N] [--fov DEGREES]
        [--map-fov DEGREES] [--agreeing 40]

The photos are reconstructed, joined and adjusted with their positions as priors, as by `expmap landmarks
build`. The first part of the output has the share of photos in the largest model, and the distances of its
cameras from the placed positions. With `--queries`, `verified` and `landmarks` answer the same queries from
the same index, and `both` combines them: the answer of `landmarks` if at least `--agreeing` landmarks agree
and it is within the place of `verified`, else that of `verified`. Errors are in units of `--unit` pixels.
Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from webapp.configuration import load_settings
from webapp.core.features.table import Method
from webapp.core.hypotheses.model import Hypothesis
from webapp.files.localize import queries_csv
from webapp.files.localize.queries_csv import Query
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import restrain_threads
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.reconstruct import reconstruct
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions

LIMITS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Error limits for the shares that are printed, in units."""


@dataclass(frozen=True, slots=True)
class Pair:
    """The most probable place of one query by each method; None if a method has none."""

    query: Query
    verified: Hypothesis | None
    landmarks: Hypothesis | None

    def combined(self, *, agreeing: int, place_radius_px: float) -> Hypothesis | None:
        """Return the place by landmarks if enough agree and it is within the other place, else the other."""
        camera = self.landmarks.camera if self.landmarks else None
        if self.verified is None or self.landmarks is None or camera is None or camera.landmarks < agreeing:
            return self.verified
        apart = math.dist(self.verified.position, self.landmarks.position)
        return self.landmarks if apart <= place_radius_px else self.verified


def cloud_figures(cfg: Path, *, unit: float) -> dict[str, object]:
    """Reconstruct the map's photos with their positions as priors, and compare cameras and positions."""
    the_map, started = read_map(cfg), time.perf_counter()
    found = reconstruct(cfg, the_map, settings=load_settings(), progress=Progress())
    before = [len(submodel) for submodel in found.submodels]
    found, adjusted = adjust_submodels(found, the_map, progress=Progress())
    largest = max(adjusted, key=lambda submodel: len(submodel.photos) if not submodel.problem else 0)
    residual = np.array([*largest.residual_px.values()]) / unit
    quarters = np.percentile(residual, (25, 50, 75)) if len(residual) else np.full(3, np.nan)
    return {
        "photos": len(found.photos),
        "pieces_before": before,
        "pieces": [len(submodel) for submodel in found.submodels],
        "share_in_largest": round(len(largest.photos) / len(found.photos), 3),
        "camera_residual_quartiles": [round(float(one), 3) for one in quarters],
        "seconds": round(time.perf_counter() - started, 1),
    }


def answers(localizer: LocalizationPipeline, queries: Sequence[Query]) -> list[Hypothesis | None]:
    """Localize the queries; return the most probable place of each."""
    found = (localizer.localize(query.path, top=1).hypotheses for query in queries)
    return [places[0] if places else None for places in found]


def shares(pairs: Sequence[tuple[Query, Hypothesis | None]], *, unit: float) -> dict[str, float]:
    """Return the shares of queries answered within each limit, and of those without an answer."""
    error = np.array([math.dist(one.position, query.truth) if one else math.inf for query, one in pairs])
    near = {f"within_{limit:g}": round(float(np.mean(error / unit <= limit)), 3) for limit in LIMITS}
    return {**near, "unanswered": round(float(np.mean(~np.isfinite(error))), 3)}


def evidence_figures(options: argparse.Namespace) -> dict[str, object]:
    """Localize the queries by each method and by both combined."""

    def opened(method: Method) -> LocalizationPipeline:
        asked = OpenOptions(method=method, features="sift", map_fov_deg=options.map_fov)
        return open_pipeline(
            options.map, asked, settings=load_settings(), progress=Progress(), fov_deg=options.fov
        )

    queries = queries_csv.select(queries_csv.read(options.queries), options.limit)
    localizer = opened("verified")
    verified, landmarks = answers(localizer, queries), answers(opened("landmarks"), queries)
    pairs = [Pair(*one) for one in zip(queries, verified, landmarks, strict=True)]
    both = [
        one.combined(agreeing=options.agreeing, place_radius_px=localizer.place_radius_px) for one in pairs
    ]
    by_method = {"verified": verified, "landmarks": landmarks, "both": both}
    return {
        "queries": len(queries),
        **{
            name: shares([*zip(queries, found, strict=True)], unit=options.unit)
            for name, found in by_method.items()
        },
        "taken_from_landmarks": sum(
            one is not None and one is pair.landmarks for one, pair in zip(both, pairs, strict=True)
        ),
    }


def main() -> None:
    """Run as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("--unit", type=float, default=1.0, help="pixels")
    parser.add_argument("--queries", type=Path)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--fov", type=float)
    parser.add_argument("--map-fov", type=float)
    parser.add_argument("--agreeing", type=int, default=40, help="landmarks")
    options = parser.parse_args()
    restrain_threads()
    figures: dict[str, object] = {"cloud": cloud_figures(options.map, unit=options.unit)}
    if options.queries:
        figures["localization"] = evidence_figures(options)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
