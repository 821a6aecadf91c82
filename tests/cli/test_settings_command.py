"""`expmap settings`, the settings file, and options that override both."""

import json
import os
import shutil

import pytest

from webapp.configuration import CONFIG


@pytest.fixture(autouse=True)
def no_config(monkeypatch):
    """Forget the settings file named by a command."""
    monkeypatch.setenv(CONFIG, "")


def test_every_value_is_printed_with_its_source(expmap, monkeypatch, tmp_path):
    (tmp_path / "my.toml").write_text('token = "abc"\n[extract]\nkeypoints = 500\n')
    monkeypatch.setenv("EXPMAP_EXTRACT_MAX_SIDE_PX", "640")
    code, out, _ = expmap("--config", tmp_path / "my.toml", "settings")
    assert code == 0
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert rows["extract.keypoints"] == ["500", "EXPMAP_EXTRACT_KEYPOINTS", str(tmp_path / "my.toml")]
    assert rows["extract.max_side_px"] == ["640", *["EXPMAP_EXTRACT_MAX_SIDE_PX"] * 2]
    assert rows["models"] == ["none", "EXPMAP_MODELS", "default"]
    assert "abc" not in out
    assert os.environ[CONFIG] == str(tmp_path / "my.toml"), "for the processes that a command starts"
    found = {one["setting"]: one for one in json.loads(expmap("settings", "--json")[1])}
    assert found["extract.keypoints"]["value"] == 500
    assert found["token"]["value"] == "(secret)"


def test_a_wrong_file_ends_with_what_is_wrong_in_it(expmap, tmp_path):
    (tmp_path / "my.toml").write_text("[extract]\nkeypoint = 500\n")
    code, _, err = expmap("--config", tmp_path / "my.toml", "settings")
    assert code == 2
    assert "my.toml: extract.keypoint: unknown setting (known in extract: max_side_px" in err
    assert expmap("--config", tmp_path / "none.toml", "settings")[0] == 2


def test_options_choose_what_is_computed_and_each_choice_has_an_index(
    expmap, tmp_path, make_map, monkeypatch
):
    cfg = make_map(tmp_path / "map", 2)

    def index(*options):
        return json.loads(expmap("build", cfg, "--method", "vote", "--json", *options)[1])

    usual = index()
    few = index("--max-side", 320, "--keypoints", 50)
    assert few["descriptors"] <= 100 < usual["descriptors"]
    assert few["folder"] != usual["folder"]
    monkeypatch.setenv("EXPMAP_EXTRACT_KEYPOINTS", "50")
    monkeypatch.setenv("EXPMAP_EXTRACT_MAX_SIDE_PX", "320")
    again = index()
    assert (again["folder"], again["extracted"]) == (few["folder"], 0)
    assert index("--keypoints", 1000, "--max-side", 800)["folder"] == usual["folder"]
    photo = tmp_path / "map" / "photos" / "1.jpg"
    ask = ("localize", cfg, photo, "--method", "vote", "--json")
    assert json.loads(expmap(*ask)[1])[0]["statistics"]["keypoints"] <= 50
    assert json.loads(expmap(*ask, "--keypoints", 200)[1])[0]["statistics"]["keypoints"] > 50
    code, _, err = expmap("build", cfg, "--keypoints", 1)
    assert code == 2
    assert "--keypoints" in err


def test_the_shortlist_limits_what_is_verified(expmap, ready_sample, tmp_path):
    folder = shutil.copytree(ready_sample, tmp_path / "sample")
    cfg, photo = folder / "map.cfg", folder / "queries" / "query_02.jpg"
    ask = ("localize", cfg, photo, "--json", "--top", 50)
    found = {}
    for n in (1, 12):
        code, out, err = expmap(*ask, "--shortlist", n)
        assert code == 0, err
        (answer,) = json.loads(out)
        found[n] = {e for h in answer["hypotheses"] if h["inliers"] for e in h["experiences"]}
    assert len(found[1]) == 1
    assert len(found[12]) > 1
    assert len(list(folder.rglob("calibration-verified-ivf*.json"))) == 2
