"""`expmap map calibrate`: real queries count in the calibration, until they are forgotten."""

import re

import numpy as np
import pytest

from webapp.core.hypotheses.calibration import EVIDENCE
from webapp.tasks.localize.trials import Trial, with_queries

HIDDEN = ("photo", "nothing", "surroundings")


@pytest.fixture
def listed(make_map, tmp_path):
    """A map of six photos, and a list of four real queries on it."""
    cfg = make_map(tmp_path / "map", 6)
    rows = [line.split(";")[1:4] for line in cfg.read_text().splitlines()[1:5]]
    queries = tmp_path / "real.csv"
    lines = [f"map/{photo};{x};{y}" for photo, x, y in rows]
    queries.write_text("\n".join(["path;x;y", *lines]) + "\n")
    return cfg, queries


def counts(done):
    """Number of own photos and of real queries that a calibration was fitted on."""
    code, printed, said = done
    assert code == 0, said
    return re.search(r"calibrated on (\d+) of the map's own photos and (\d+) real queries", printed).groups()


def test_real_queries_count_until_they_are_forgotten(expmap, listed):
    cfg, queries = listed
    options = (cfg, "--features", "sift", "--jobs", "1")
    assert counts(expmap("map", "calibrate", *options, "--queries", queries)) == ("6", "4")
    kept = cfg.with_name("map.queries.csv")
    assert str(cfg.parent / "photos") in kept.read_text()
    queries.unlink()  # the map has its own copy of the list
    assert counts(expmap("map", "calibrate", *options)) == ("6", "4")
    kept.write_text(kept.read_text() + f"{cfg.parent}/gone.jpg;1;1\n")
    assert counts(expmap("map", "calibrate", *options)) == ("6", "4")  # a photo that is gone is left out
    assert counts(expmap("map", "calibrate", *options, "--forget")) == ("6", "0")
    assert not kept.exists()


def test_a_list_with_a_photo_that_cannot_be_read_is_refused(expmap, listed):
    cfg, queries = listed
    queries.write_text(queries.read_text() + "map/none.jpg;1;1\n")
    code, _, said = expmap("map", "calibrate", cfg, "--queries", queries)
    assert code != 0
    assert "none.jpg" in said
    assert not cfg.with_name("map.queries.csv").exists()


def test_real_queries_take_over_with_their_number():
    def trial(hidden):
        return Trial(np.zeros((0, EVIDENCE)), [], (0.0, 0.0), hidden, strong=False, seconds=0.0)

    own = {n: trial("surroundings" if n % 4 == 1 else "photo") for n in range(8)}
    found = with_queries(own, {n: trial("nothing") for n in range(10)})
    weight = {kind: sum(t.weight for t in found.values() if t.hidden == kind) for kind in HIDDEN}
    assert weight == pytest.approx({"photo": 3.0, "nothing": 3.0, "surroundings": 2 * own[1].weight})
    assert with_queries(own, {}) == own
