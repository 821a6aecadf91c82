"""A small evaluation with real files: a plan, three map photos, four queries, one of them broken."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from webapp.core.evaluation.metrics import QueryResult, summarise
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Evidence, Hypothesis, MatchStatistics
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.tasks.evaluation.types import Evaluation, Subject

STATISTICS = MatchStatistics(100, 80, 50, 0.1, 0.9, 0.4, 32.0)
SECONDS = {"extract": 0.1, "retrieve": 0.2, "total": 0.4}
EVIDENCE = Evidence(
    0,
    np.array([[10, 20], [50, 60]], np.float32),
    np.array([[12, 22], [90, 10]], np.float32),
    np.array([True, False]),
)


def hypothesis(rank: int, at: tuple[float, float], probability: float) -> Hypothesis:
    return Hypothesis(rank, "position", MapPixel(*at), probability, 12.0, 90.0, (0, 1), 1, 2)


def make_evaluation(folder: Path) -> Evaluation:
    """Write the files and return the evaluation; `folder` contains both the map and the queries."""
    names = ["0.jpg", "1.jpg", "2.jpg", "a & b.jpg", "q1.jpg", "q2.jpg"]
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((80, 120, 3), 40 * i, np.uint8))
    cv2.imwrite(str(folder / "plan.png"), np.full((300, 400, 3), 200, np.uint8))
    experiences = tuple(Experience(i, f"{i}.jpg", MapPixel(100.0 * i + 60, 150)) for i in range(3))
    themap = Map(SatelliteImage("plan.png", 400, 300), experiences)
    good = Answer(
        (hypothesis(1, (64, 153), 0.8), hypothesis(2, (260, 150), 0.1)),
        0.1, 0.0, None, STATISTICS, (EVIDENCE,), SECONDS,
    )  # fmt: skip
    bad = replace(good, hypotheses=(hypothesis(1, (260, 150), 0.4),), off_map_probability=0.6)
    none = Answer((), 1.0, 0.0, NoPose("no match left"), STATISTICS, (), SECONDS)
    results = (
        QueryResult("a & b.jpg", MapPixel(60, 150), good),
        QueryResult("q1.jpg", MapPixel(60, 150), bad),
        QueryResult("q2.jpg", MapPixel(160, 150), none),
        QueryResult("<script>.jpg", MapPixel(160, 150), None, "the file is <b>no</b> photo"),
    )
    subject = Subject(folder, "verified", "sift", themap, "c0ffee", 20.0, "metric", 1.0, None, 5_000_000)
    return Evaluation(
        subject=subject,
        scheme="queries",
        hide_within_px=None,
        query_folder=folder,
        results=results,
        summary=summarise(results, place_radius_px=20.0, rng=np.random.default_rng(0)),
        seed=0,
        peak_rss_mb=None,
        versions={"python": "3"},
    )


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    return make_evaluation(tmp_path_factory.mktemp("evaluated"))


@pytest.fixture(scope="session")
def georeferenced(evaluation: Evaluation) -> Evaluation:
    """The same on a map with half a metre per pixel and east up."""
    turned = Georeference("EPSG:32633", (0.0, -0.5, 500_000, -0.5, 0.0, 5_500_000, 0, 0, 1), "affine")
    themap = replace(evaluation.subject.map, georeference=turned)
    return replace(evaluation, subject=replace(evaluation.subject, map=themap))
