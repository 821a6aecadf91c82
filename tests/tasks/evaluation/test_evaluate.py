import json
from pathlib import Path

import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.errors import Cancelled, PhotoError, TableError, UsageError
from webapp.progress import Progress
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation.types import EvaluateOptions

CONTRACT_KEYS = {
    "method", "features", "map_photos", "queries", "failed", "abstained", "median_px", "mean_px",
    "within_10px", "within_20px", "within_50px", "within_100px", "within_400px", "top5_within_50px", "ece",
    "radius_coverage", "build_seconds", "calibration_seconds", "index_bytes", "peak_rss_mb",
    "seconds_per_query_p50", "seconds_per_query_p95", "extract_seconds_p50", "match_seconds_p50", "seed",
    "versions", "map_hash", "per_query",
}  # fmt: skip

LINE = Map(
    SatelliteImage("plan.png", 400, 100),
    tuple(Experience(i, f"photos/{i}.jpg", MapPixel(10.0 * i, 50.0), heading_deg=90.0) for i in range(10)),
)


class NearestVisible:
    """Answers with the visible experience closest to the number in the photo's name, 3 px too far right."""

    method, features, map, map_hash = "verified", "sift", LINE, "abc"
    place_radius_px, map_kind, build_seconds, calibration_seconds, index_bytes = (
        20.0,
        "metric",
        1.5,
        None,
        1234,
    )

    def __init__(self) -> None:
        self.asked: list[tuple[str, int, frozenset[int]]] = []

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        self.asked.append((photo_path.as_posix(), top, hide))
        if photo_path.stem == "broken":
            raise PhotoError("not a photo", where=str(photo_path))
        true_x = 10.0 * int(photo_path.stem)
        visible = [e for e in LINE.experiences if e.id not in hide]
        best = min(visible, key=lambda e: abs(e.position.x - true_x))
        place = MapPixel(best.position.x + 3, 50)
        found = Hypothesis(1, "position", place, 0.9, 5.0, 80.0, (best.id,), 30, 60)
        statistics = MatchStatistics(100, 90, 50, 0.1, 0.9, 0.4, 36.0)
        return Answer((found,), 0.1, 0.0, None, statistics, (), {"extract": 0.1, "total": 0.3})


@pytest.fixture
def queries(tmp_path: Path) -> Path:
    path = tmp_path / "queries.csv"
    lines = ["path;x;y", *(f"q/{i}.jpg;{10 * i};50" for i in range(4)), "q/broken.jpg;0;0"]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_evaluates_a_list_and_keeps_failures_as_results(queries: Path, tmp_path: Path) -> None:
    localizer = NearestVisible()
    done = evaluate.evaluate_queries(localizer, queries, map_folder=tmp_path)
    assert (done.scheme, done.summary.queries, done.summary.failed) == ("queries", 5, 1)
    assert done.summary.median_px == pytest.approx(3)
    assert done.summary.within[10] == pytest.approx(0.8)
    assert "not a photo" in str(done.results[-1].error)
    assert localizer.asked[0] == ((tmp_path / "q/0.jpg").as_posix(), 5, frozenset())


def test_json_has_the_keys_of_the_interface_and_plain_values(queries: Path, tmp_path: Path) -> None:
    form = evaluate.to_json(evaluate.evaluate_queries(NearestVisible(), queries, map_folder=tmp_path))
    assert set(form) >= CONTRACT_KEYS
    json.dumps(form, allow_nan=False)
    first, last = form["per_query"][0], form["per_query"][-1]
    assert (first["path"], first["truth"], first["error_px"]) == ("q/0.jpg", {"x_px": 0, "y_px": 50}, 3.0)
    assert first["answer"]["hypotheses"][0]["x_px"] == 3.0
    assert last["error_px"] is None
    assert set(last["answer"]) == {"query", "error"}
    assert set(form["versions"]) == {"python", "numpy", "opencv", "faiss", "experience-map"}
    assert form["map_photos"] == 10


def test_same_seed_gives_the_same_intervals(queries: Path, tmp_path: Path) -> None:
    runs = [
        evaluate.evaluate_queries(
            NearestVisible(), queries, map_folder=tmp_path, options=EvaluateOptions(seed=s)
        )
        for s in (1, 1, 2)
    ]
    assert runs[0].summary.intervals == runs[1].summary.intervals
    assert runs[0].seed == 1


def test_self_evaluation_hides_the_photo_and_then_its_place(tmp_path: Path) -> None:
    localizer = NearestVisible()
    one, place = evaluate.evaluate_self(localizer, map_folder=tmp_path)
    assert (one.scheme, one.hide_within_px) == ("leave-one-out", None)
    assert (place.scheme, place.hide_within_px) == ("leave-one-place-out", 20.0)
    assert localizer.asked[5] == ((tmp_path / "photos/5.jpg").as_posix(), 5, frozenset({5}))
    assert localizer.asked[15][2] == frozenset({3, 4, 5, 6, 7})
    assert one.results[5].error_px == pytest.approx(7)
    assert place.results[5].error_px == pytest.approx(27)
    assert one.results[5].truth_heading_deg == 90.0


def test_self_evaluation_with_a_distance_is_one_run(tmp_path: Path) -> None:
    localizer = NearestVisible()
    options = EvaluateOptions(limit=2, hide_within_px=10)
    (place,) = evaluate.evaluate_self(localizer, map_folder=tmp_path, options=options)
    assert (place.scheme, place.hide_within_px, place.summary.queries) == ("leave-one-place-out", 10, 2)
    assert [hide for _, _, hide in localizer.asked] == [frozenset({0, 1}), frozenset({4, 5, 6})]


def test_self_evaluation_of_an_empty_map_is_refused(tmp_path: Path) -> None:
    class Empty(NearestVisible):
        map = Map(SatelliteImage("plan.png", 400, 100), ())

    with pytest.raises(UsageError, match="no photos"):
        evaluate.evaluate_self(Empty(), map_folder=tmp_path)


class Watching(Progress):
    def __init__(self, stop_after: int) -> None:
        self.steps, self.total, self.stop_after = 0, 0, stop_after

    def size(self, total: int) -> None:
        self.total = total

    def advance(self, steps: int = 1) -> None:
        self.steps += steps

    def cancelled(self) -> bool:
        return self.steps >= self.stop_after


def test_progress_counts_every_query_of_both_runs(tmp_path: Path) -> None:
    progress = Watching(1000)
    evaluate.evaluate_self(NearestVisible(), map_folder=tmp_path, progress=progress)
    assert (progress.steps, progress.total) == (20, 20)


def test_stops_between_queries(queries: Path, tmp_path: Path) -> None:
    localizer = NearestVisible()
    with pytest.raises(Cancelled):
        evaluate.evaluate_queries(localizer, queries, map_folder=tmp_path, progress=Watching(2))
    assert len(localizer.asked) == 2


def test_bad_list_is_no_failed_query(tmp_path: Path) -> None:
    with pytest.raises(TableError):
        evaluate.evaluate_queries(NearestVisible(), tmp_path / "none.csv", map_folder=tmp_path)


def test_memory_is_that_of_a_python_process() -> None:
    peak = evaluate.peak_rss_mb()
    assert peak is None or 20 < peak < 50_000
