"""`expmap localize` on the command line: text, JSON, pictures, exit codes."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from webapp.cli.localize import answer_text
from webapp.core.features.blank import FEW_KEYPOINTS, FEWEST_KEYPOINTS
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import build_map
from webapp.tasks.localize.plan import OpenOptions

ANSWER = {
    "query", "method", "features", "fov_deg", "fov_source", "hypotheses", "other_probability",
    "off_map_probability", "statistics", "seconds", "map_revision", "map_kind", "place_radius_px", "looks",
    "verdict", "sentence",
}  # fmt: skip
HYPOTHESIS = {
    "rank", "kind", "x_px", "y_px", "radius_px", "heading_deg", "lat", "lon", "radius_m", "probability",
    "experiences", "inliers", "matches",
}  # fmt: skip
STATISTICS = {
    "keypoints", "matches", "matches_pruned", "distance_min", "distance_max", "distance_mean",
    "distance_total",
}  # fmt: skip
SECONDS = {"read", "extract", "retrieve", "verify", "position", "total"}


@pytest.fixture(scope="module")
def cfg(make_map, tmp_path_factory) -> Path:
    """A read-only map with its index, so that tests do not depend on their order."""
    cfg = make_map(tmp_path_factory.mktemp("map"), 6)
    build_map.build_map(cfg, OpenOptions(features="sift"), settings=Settings(), progress=Progress())
    return cfg


@pytest.fixture
def photos(cfg) -> Path:
    return cfg.parent / "photos"


def check_shape(answer: dict) -> None:
    assert answer.keys() == ANSWER
    assert answer["statistics"].keys() == STATISTICS
    assert answer["seconds"].keys() == SECONDS
    for rank, hypothesis in enumerate(answer["hypotheses"], 1):
        assert hypothesis.keys() == HYPOTHESIS
        assert hypothesis["rank"] == rank
        assert 0.0 <= hypothesis["probability"] <= 1.0
    total = sum(h["probability"] for h in answer["hypotheses"]) + answer["other_probability"]
    assert total + (answer["off_map_probability"] or 0.0) == pytest.approx(1.0)


def test_vote_as_json(expmap, cfg, photos):
    code, out, _ = expmap("localize", cfg, photos / "3.jpg", "--method", "vote", "--json")
    (answer,) = json.loads(out)
    assert code == 0
    check_shape(answer)
    assert (answer["query"], answer["method"], answer["features"]) == (str(photos / "3.jpg"), "vote", "sift")
    assert (answer["fov_deg"], answer["fov_source"], answer["off_map_probability"]) == (None, None, None)
    best = answer["hypotheses"][0]
    assert (best["kind"], best["experiences"], best["x_px"], best["y_px"]) == ("photo", [3], 400.0, 100.0)
    assert best["probability"] > 0.9
    unknown = ("radius_px", "heading_deg", "lat", "lon", "radius_m", "inliers")
    assert [best[name] for name in unknown] == [None] * 6
    assert answer["statistics"]["distance_max"] == 0.0 == answer["statistics"]["distance_total"]
    assert answer["seconds"]["verify"] is None is answer["seconds"]["position"]
    assert answer["seconds"]["total"] >= answer["seconds"]["extract"] > 0


def test_auto_as_json(expmap, cfg, photos):
    code, out, _ = expmap("localize", cfg, photos / "3.jpg", "--json", "--fov", "61")
    (answer,) = json.loads(out)
    assert code == 0
    check_shape(answer)
    assert (answer["method"], answer["fov_deg"], answer["fov_source"]) == ("auto", 61.0, "option")
    assert answer["off_map_probability"] is not None
    assert answer["hypotheses"][0]["experiences"][0] == 3
    assert answer["hypotheses"][0]["radius_px"] > 0
    assert None not in answer["seconds"].values()


def test_a_failed_photo_has_query_and_error_and_the_others_an_answer(expmap, cfg, photos, tmp_path):
    (tmp_path / "bad.jpg").write_bytes(b"no photo")
    queries = [photos / "1.jpg", tmp_path / "bad.jpg", tmp_path / "none.jpg", tmp_path, photos / "2.jpg"]
    code, out, err = expmap("localize", cfg, *queries, "--method", "vote", "--json")
    answers = json.loads(out)
    assert code == 1
    assert [a["query"] for a in answers] == [str(q) for q in queries]
    assert [a.keys() == {"query", "error"} for a in answers] == [False, True, True, True, False]
    assert all(str(q) in a["error"] for q, a in zip(queries, answers, strict=True) if "error" in a)
    assert sum(line.startswith("expmap: ") for line in err.splitlines()) == 3
    assert "Traceback" not in err


def test_text_for_several_photos(expmap, cfg, photos):
    code, out, err = expmap(
        "localize", cfg, photos / "1.jpg", photos / "2.jpg", "--method", "vote", "--top", "1"
    )
    assert (code, err) == (0, "")
    first, second = out.split("\n\n")
    assert first.splitlines()[0] == f"{photos / '1.jpg'}: near the photo with id 1 at x 200, y 100"
    assert second.splitlines()[0] == f"{photos / '2.jpg'}: near the photo with id 2 at x 300, y 100"
    assert first.splitlines()[1].split() == ["probability", "x", "y", "photos"]
    assert first.splitlines()[2].split()[0] == "1"


@pytest.mark.parametrize(
    "case",
    json.loads((Path(__file__).parents[1] / "render" / "verdicts.json").read_text(encoding="utf-8")),
    ids=str,
)
def test_an_uncertain_answer_is_called_uncertain(case):
    verdict = {
        "place": "at x 20, y 30",
        "perhaps_place": "uncertain, perhaps at x 20, y 30",
        "perhaps_off_map": "uncertain, perhaps not on this map",
        "off_map": "probably not on this map",
    }[case["verdict"]]
    probability, off_map = case["probability"], case["off_map"]
    place = Hypothesis(1, "position", MapPixel(20, 30), probability, 5.0, None, (1,), 20, 40)
    statistics = MatchStatistics(100, 80, 50, 0.1, 0.9, 0.4, 32.0)
    text = answer_text(Answer((place,), off_map, 0.0, None, statistics), query="q.jpg", georeference=None)
    assert text.splitlines()[0] == f"q.jpg: {verdict}"


def test_what_is_missing_is_said_below_the_places():
    place = Hypothesis(1, "position", MapPixel(20, 30), 0.8, 5.0, None, (1,), 20, 40)
    statistics = MatchStatistics(100, 80, 50, 0.1, 0.9, 0.4, 32.0)
    answer = Answer((place,), 0.2, 0.0, None, statistics, note="too few landmarks agree")
    assert answer_text(answer, query="q.jpg", georeference=None).splitlines()[-1].strip() == answer.note


def test_photo_and_map_in_the_wrong_order_are_explained(expmap, cfg, photos):
    code, _, err = expmap("localize", photos / "1.jpg", cfg)
    assert code == 3
    assert "the file is an image and not a map (name the map's .cfg file)" in err


def test_a_folder_is_no_photo(expmap, cfg, photos):
    code, _, err = expmap("localize", cfg, photos, "--method", "vote")
    assert code == 1
    assert err.endswith(f"{photos}: it is a folder and not a photo (name photos, not their folder)\n")


def test_two_pictures_need_two_files(expmap, cfg, photos, tmp_path):
    same = tmp_path / "both.png"
    code, _, err = expmap("localize", cfg, photos / "1.jpg", "--picture", same, "--matches", same)
    assert (code, err) == (2, "expmap: --picture: must not be the file of --matches (choose another file)\n")
    assert not same.exists()


def test_a_guessed_field_of_view_is_reported_on_standard_error(expmap, cfg, photos):
    code, out, err = expmap("localize", cfg, photos / "1.jpg")
    assert code == 0
    assert "not on this map" in out
    assert "the field of view of 1.jpg is not known; 65° is assumed; --fov DEGREES" in err


def test_a_few_keypoints_that_agree_with_no_photo_are_no_place(expmap, cfg, tmp_path):
    night, path = np.zeros((480, 640, 3), np.uint8), tmp_path / "lamps.png"
    for number in range(5):
        cv2.circle(night, (90 + 115 * number, 140 + 60 * (number % 3)), 12 + 2 * number, (120, 120, 120), -1)
    cv2.imwrite(str(path), night)
    code, out, _ = expmap("localize", cfg, path, "--method", "verified", "--json")
    (answer,) = json.loads(out)
    keypoints = answer["statistics"]["keypoints"]
    assert FEWEST_KEYPOINTS <= keypoints < FEW_KEYPOINTS  # enough to be compared
    assert (code, answer["verdict"], answer["hypotheses"]) == (0, "nothing_to_see", [])
    assert f"only {keypoints} keypoints" in answer["no_pose"]


def test_a_photo_without_texture_has_nothing_to_see(expmap, cfg, tmp_path):
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), cv2.imread(str(cfg.parent / "plan.png")))
    for method in ("vote", "verified"):
        code, out, _ = expmap("localize", cfg, flat, "--method", method)
        assert code == 0
        assert out.startswith(f"{flat}: no place (nothing to recognise: the photo is nearly uniform)")
        code, out, _ = expmap("localize", cfg, flat, "--method", method, "--json")
        (answer,) = json.loads(out)
        assert code == 0
        assert answer["hypotheses"] == []
        assert answer["statistics"]["keypoints"] == 0
        assert answer["off_map_probability"] is None
        assert answer["verdict"] == "nothing_to_see"
        assert answer["sentence"].startswith("Nothing to recognise in this photo")
        assert answer["no_pose"].endswith("the photo is nearly uniform")


def test_top_limits_the_list(expmap, cfg, photos, tmp_path):
    both = tmp_path / "both.jpg"
    cv2.imwrite(
        str(both), cv2.hconcat([cv2.imread(str(photos / "1.jpg")), cv2.imread(str(photos / "4.jpg"))])
    )
    code, out, _ = expmap("localize", cfg, both, "--method", "vote", "--top", "1", "--json")
    (answer,) = json.loads(out)
    assert code == 0
    check_shape(answer)
    assert len(answer["hypotheses"]) == 1
    assert answer["other_probability"] > 0.2


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_pictures_are_drawn_and_numbered(expmap, cfg, photos, tmp_path, method):
    options = ["--method", method, "--picture", tmp_path / "where.png", "--matches", tmp_path / "match.jpg"]
    code, out, err = expmap("localize", cfg, photos / "1.jpg", *options)
    assert code == 0
    assert "drawn" not in out
    assert err.count("drawn: ") == 2
    assert {p.name for p in tmp_path.iterdir()} == {"where.png", "match.jpg"}
    assert cv2.imread(str(tmp_path / "match.jpg")).shape[1] > 600  # two photos side by side
    expmap("localize", cfg, photos / "1.jpg", photos / "2.jpg", *options)
    names = {"where.png", "match.jpg", "where-1.png", "where-2.png", "match-1.jpg", "match-2.jpg"}
    assert {p.name for p in tmp_path.iterdir()} == names
    one, two = (cv2.imread(str(tmp_path / f"where-{i}.png")) for i in (1, 2))
    assert one.shape == two.shape
    assert (one != two).any()


def test_no_matches_is_no_match_picture(expmap, cfg, tmp_path):
    code, _, err = expmap(
        "localize", cfg, cfg.parent / "plan.png", "--method", "vote", "--matches", tmp_path / "m.png"
    )
    assert code == 0
    assert "no matches to draw" in err
    assert list(tmp_path.iterdir()) == []


def test_an_answer_stands_when_its_picture_cannot_be_drawn(expmap, make_map, tmp_path):
    cfg = make_map(tmp_path / "map", 3)
    (cfg.parent / "plan.png").write_bytes(b"gone")
    photo = cfg.parent / "photos" / "1.jpg"
    options = ["--method", "vote", "--json", "--picture", tmp_path / "where.png"]
    code, out, err = expmap("localize", cfg, photo, *options)
    assert code == 1
    assert json.loads(out)[0]["hypotheses"][0]["experiences"] == [1]
    assert "plan.png" in err


def test_map_photos_that_cannot_be_used_are_reported_when_the_index_is_built(expmap, make_map, tmp_path):
    cfg = make_map(tmp_path / "map", 4)
    (cfg.parent / "photos" / "0.jpg").unlink()
    photo = cfg.parent / "photos" / "1.jpg"
    code, out, err = expmap("localize", cfg, photo, "--method", "vote", "--json")
    assert code == 0
    assert len(json.loads(out)) == 1
    assert err.startswith("building the index ...\n")
    assert "photos/0.jpg (id 0): file not found" in err
    assert expmap("localize", cfg, photo, "--method", "vote", "--json")[2] == ""


@pytest.fixture
def own_sample(ready_sample, tmp_path):
    """A copy of the sample with its index."""
    return shutil.copytree(ready_sample, tmp_path / "sample")


@pytest.mark.parametrize("page", ["README.md", "docs/first-map.md"])
def test_the_documents_show_the_answer_that_is_given(expmap, own_sample, page):
    first = re.compile(r"^1 +>99 % +(\d+) +(\d+) +([\d.]+) m +(\d+)°", re.MULTILINE)
    _, out, _ = expmap("localize", own_sample / "map.cfg", own_sample / "queries" / "query_02.jpg")
    text = (Path(__file__).parents[2] / page).read_text("utf-8")
    shown, given = (np.array(first.search(said).groups(), float) for said in (text, out))
    assert given == pytest.approx(shown, abs=1.0)


def test_a_georeferenced_map_gives_latitude_and_metres(expmap, own_sample):
    queries = sorted((own_sample / "queries").glob("*.jpg"))[:2]
    code, out, _ = expmap("localize", own_sample / "map.cfg", *queries, "--json")
    answers = json.loads(out)
    assert code == 0
    for answer in answers:
        check_shape(answer)
        assert answer["fov_source"] == "exif"
        best = answer["hypotheses"][0]
        assert None not in (best["lat"], best["lon"], best["radius_m"])
    code, out, err = expmap("localize", own_sample / "map.cfg", queries[1])
    assert (code, err) == (0, "")
    assert "latitude" in out
    assert " m " in out


def test_what_is_not_sure_can_be_looked_at_closer(expmap, own_sample):
    asked = ["localize", own_sample / "map.cfg", own_sample / "queries" / "off_map.jpg"]
    assert "expmap models fetch" in expmap(*asked)[2]
    assert "--method thorough" in expmap(*asked, "--method", "verified")[2]
    assert expmap(*asked, "--json")[2] == ""


@pytest.mark.parametrize("budget", ["nan", "inf"])
def test_a_budget_is_a_number_of_seconds(expmap, cfg, photos, budget):
    code, _, said = expmap("localize", cfg, photos / "1.jpg", "--budget", budget)
    assert code == 2
    assert "--budget" in said


def test_a_stretched_photo_is_noted_in_text_and_json(expmap, cfg, photos, tmp_path):
    """A photo of 16 bits that uses few of them, like that of a thermal camera."""
    gray = np.asarray(Image.open(photos / "3.jpg").convert("L"), np.uint16)
    Image.fromarray((7000 + gray * 4).astype(np.uint16)).save(tmp_path / "thermal.png")
    options = ("--features", "sift", "--method", "vote")
    (found,) = json.loads(expmap("localize", cfg, tmp_path / "thermal.png", "--json", *options)[1])
    assert found["note"].startswith("its contrast was stretched: nearly all of its 16-bit values are from 7")
    assert found["note"] in expmap("localize", cfg, tmp_path / "thermal.png", *options)[1]
    assert "note" not in json.loads(expmap("localize", cfg, photos / "3.jpg", "--json", *options)[1])[0]
