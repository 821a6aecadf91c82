"""`expmap evaluate` on the command line."""

import json
from pathlib import Path

import pytest

REQUIRED = {
    "method", "features", "map_photos", "queries", "failed", "abstained", "median_px", "mean_px",
    "within_10px", "within_20px", "within_50px", "within_100px", "within_400px", "top5_within_50px", "ece",
    "radius_coverage", "build_seconds", "calibration_seconds", "index_bytes", "peak_rss_mb",
    "seconds_per_query_p50", "seconds_per_query_p95", "extract_seconds_p50", "match_seconds_p50", "seed",
    "versions", "map_hash", "per_query",
}  # fmt: skip


@pytest.fixture(scope="module")
def cfg(make_map, tmp_path_factory) -> Path:
    cfg = make_map(tmp_path_factory.mktemp("map"), 6)
    lines = [f"photos/{i}.jpg;{100 * i + 100};{110}" for i in range(6)]
    (cfg.parent / "queries.csv").write_text("\n".join(["path;x;y", *lines]) + "\n")
    return cfg


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_json_is_one_object_with_every_figure(expmap, cfg, method):
    code, out, _ = expmap("evaluate", cfg, cfg.parent / "queries.csv", "--method", method, "--json")
    figures = json.loads(out)
    assert code == 0
    assert figures.keys() >= REQUIRED
    assert (figures["method"], figures["features"]) == (method, "sift")
    assert (figures["map_photos"], figures["queries"], figures["failed"]) == (6, 6, 0)
    assert figures["within_20px"] == 1.0
    assert len(figures["per_query"]) == 6
    assert figures["build_seconds"] > 0
    assert (figures["calibration_seconds"] is None) == (method == "vote")
    assert figures["index_bytes"] > 10_000


def test_text_goes_to_standard_output_and_progress_does_not(expmap, cfg):
    code, out, err = expmap("evaluate", cfg, cfg.parent / "queries.csv", "--method", "vote", "--limit", "3")
    assert code == 0
    assert out.startswith("vote, sift: map of 6 photos, 3 queries\n")
    assert "queries ..." in err
    assert "..." not in out


def test_failed_queries_are_reported_and_end_with_1(expmap, cfg, tmp_path):
    queries = tmp_path / "queries.csv"
    queries.write_text(f"path;x;y\n{cfg.parent}/photos/1.jpg;200;100\nnone.jpg;1;1\n")
    code, out, err = expmap("evaluate", cfg, queries, "--method", "vote", "--json")
    figures = json.loads(out)
    assert (code, figures["failed"], figures["queries"]) == (1, 1, 2)
    assert "none.jpg" in err


def test_of_itself_every_photo_is_hidden(expmap, cfg):
    code, out, _ = expmap("evaluate", cfg, "--self", "--method", "vote", "--json")
    evaluations = json.loads(out)
    assert code == 0
    assert [e["scheme"] for e in evaluations] == ["leave-one-out", "leave-one-place-out"]
    for evaluation in evaluations:
        assert evaluation["queries"] == 6
        for query in evaluation["per_query"]:
            own = int(Path(query["path"]).stem)
            assert own not in [h["experiences"][0] for h in query["answer"]["hypotheses"]]


def test_a_report_is_written(expmap, cfg, tmp_path):
    code, _, err = expmap(
        "evaluate", cfg, cfg.parent / "queries.csv", "--method", "vote", "-o", tmp_path / "report"
    )
    assert code == 0
    assert f"report: {tmp_path / 'report' / 'report.html'}" in err
    assert (tmp_path / "report" / "report.html").stat().st_size > 1000
