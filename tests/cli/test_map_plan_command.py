"""`expmap map plan` for people, phones and scripts."""

import json
from dataclasses import replace

import pytest

from webapp.core.geo.georeference import Georeference
from webapp.files.exchange.gpx import GpxLine, GpxPoint, GpxWaypoint, read_gpx
from webapp.files.maps.folder import read_map, write_map

GEOREFERENCE = Georeference("EPSG:32635", (0.1, 0, 500_000, 0, -0.1, 6_700_000, 0, 0, 1), "affine")


@pytest.fixture
def cfg(tmp_path, make_map):
    """A row of eight photos that look east, ten metres apart."""
    cfg = make_map(tmp_path, 8)
    the_map = read_map(cfg)
    looking = tuple(replace(e, heading_deg=90.0) for e in the_map.experiences)
    write_map(cfg, replace(the_map, experiences=looking, georeference=GEOREFERENCE))
    return cfg


def evaluation(lost):
    """Output of `evaluate --self --json` for the row, some photos of which are not found."""
    queries = [
        {
            "path": f"photos/{n}.jpg",
            "truth": {"x_px": 100.0 * n + 100, "y_px": 100.0},
            "error_px": 900.0 if n in lost else 3.0,
            "answer": {"hypotheses": [{"heading_deg": 90.0}]},
        }
        for n in range(8)
    ]
    return json.dumps([{"scheme": "leave-one-out", "place_radius_px": 50.0, "per_query": queries}])


def test_spots_are_printed_and_lead_a_phone(expmap, cfg, tmp_path):
    gpx = tmp_path / "walk.gpx"
    code, out, err = expmap("map", "plan", cfg, "--spots", 3, "--gpx", gpx)
    assert code == 0, err
    lines = out.splitlines()
    assert [line.split()[0] for line in lines] == ["1", "2", "3"]
    assert all("look " in line and "seen in one direction only" in line for line in lines)
    assert "3 spots" in err
    assert "no evaluation of the map is known" in err
    with gpx.open("rb") as file:
        items = list(read_gpx(file))
    waypoints = [item for item in items if isinstance(item, GpxWaypoint)]
    route = [item for item in items if isinstance(item, GpxPoint)]
    assert [item.kind for item in items if isinstance(item, GpxLine)] == ["route"]
    assert [point.name for point in waypoints] == ["1", "2", "3"]
    assert [point.point for point in waypoints] == route
    shown = [tuple(map(float, line.split("  ")[2].split(", "))) for line in lines]
    for point, at in zip(route, shown, strict=True):
        assert (point.lat, point.lon) == pytest.approx(at, abs=1e-6)
        assert point.course_deg % 45 == 0
    assert "Look " in gpx.read_text("utf-8")


def test_the_plan_goes_where_photos_were_not_found(expmap, cfg, tmp_path):
    file = tmp_path / "evaluation.json"
    file.write_text(evaluation({6, 7}))
    code, out, err = expmap("map", "plan", cfg, "--spots", 2, "--evaluation", file, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert (found["trials"], found["tried"]) == ("evaluation", 8)
    assert 0 < found["recognised_share"] < found["expected_share"] < 1
    columns = found["cells"]
    assert {len(values) for values in columns.values()} == {len(columns["x_px"])}
    at = dict(zip(zip(columns["x_px"], columns["y_px"], strict=True), columns["recognised"], strict=True))
    good = [share for (x, _), share in at.items() if x < 400]
    bad = [share for (x, _), share in at.items() if x > 720]
    assert sum(bad) / len(bad) < sum(good) / len(good)
    assert found["walk_m"] == pytest.approx(0.1 * found["walk_px"], rel=0.01)
    assert expmap("map", "plan", cfg, "--evaluation", cfg)[0] == 2


def test_an_area_is_kept_to(expmap, cfg):
    _, out, _ = expmap("map", "plan", cfg, "--within", "0,0,250,200", "--json")
    spots = json.loads(out)["spots"]
    assert spots
    assert all(spot["x_px"] <= 250 for spot in spots)
    code, _, err = expmap("map", "plan", cfg, "--within", "2000,0,2500,200")
    assert (code, "not on the image" in err) == (2, True)
    for numbers in ("nan,0,10,10", "0,0,inf,10"):
        code, _, err = expmap("map", "plan", cfg, "--within", numbers)
        assert (code, "four numbers separated by commas" in err) == (2, True)


@pytest.mark.parametrize("answer", [None, []])
def test_a_file_with_other_answers_is_no_evaluation(expmap, cfg, tmp_path, answer):
    schemes = json.loads(evaluation(set()))
    schemes[0]["per_query"][0]["answer"] = answer
    file = tmp_path / "evaluation.json"
    file.write_text(json.dumps(schemes))
    code, _, err = expmap("map", "plan", cfg, "--evaluation", file)
    assert (code, "this is not an evaluation of a map" in err) == (2, True)


def test_a_map_that_does_not_know_where_it_is_gives_no_gpx(expmap, cfg, tmp_path):
    write_map(cfg, replace(read_map(cfg), georeference=None))
    code, out, _ = expmap("map", "plan", cfg, "--spots", 1)
    assert (code, "x " in out) == (0, True)
    code, _, err = expmap("map", "plan", cfg, "--gpx", tmp_path / "walk.gpx")
    assert (code, "georeference" in err) == (2, True)
    assert not (tmp_path / "walk.gpx").exists()


def test_a_map_without_photos_cannot_be_planned(expmap, cfg):
    write_map(cfg, replace(read_map(cfg), experiences=()))
    code, _, err = expmap("map", "plan", cfg)
    assert (code, "place some photos first" in err) == (2, True)
