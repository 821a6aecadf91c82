"""`expmap build` on the command line."""

import json
import sys
from pathlib import Path

import pytest

FIELDS = {
    "folder", "photos", "extracted", "reused", "removed", "failed", "descriptors", "seconds", "bytes",
    "features", "orientation_seconds", "calibration_seconds", "second_look",
    "global_descriptor",
}  # fmt: skip


@pytest.fixture
def cfg(make_map, tmp_path) -> Path:
    return make_map(tmp_path / "map", 5)


def test_what_was_built_is_one_line_on_standard_output(expmap, cfg):
    code, out, err = expmap("build", cfg, "--method", "vote")
    assert code == 0
    assert out.count("\n") == 1
    assert "5 photos with sift, 5 computed, 0 kept, 0 removed, 0 failed" in out
    assert err == "joining ...\ntraining ...\n"
    code, out, err = expmap("build", cfg, "--method", "vote")
    assert "0 computed, 5 kept" in out
    assert (code, err) == (0, "")


def test_the_time_of_the_calibration_is_in_the_sum(expmap, cfg):
    _, out, _ = expmap("build", cfg)
    index, total = out.splitlines()
    assert total.endswith(" s in total, including calibration")
    assert float(total.split()[0]) > float(index.split()[-2])


def test_json_is_one_object(expmap, cfg):
    code, out, _ = expmap("build", cfg, "--json", "--jobs", "1")
    report = json.loads(out)
    assert code == 0
    assert report.keys() == FIELDS
    assert (report["photos"], report["extracted"], report["features"]) == (5, 5, "sift")
    assert report["global_descriptor"] is False
    assert 0 < report["orientation_seconds"] < 60
    assert report["calibration_seconds"] > 0
    assert Path(report["folder"]).is_dir()


def test_the_memory_that_there_is_decides_how_the_map_is_searched(expmap, cfg, monkeypatch):
    built = []
    for memory_mb in ("500", "0", "500"):
        monkeypatch.setenv("EXPMAP_RETRIEVAL_MEMORY_MB", memory_mb)
        code, out, _ = expmap("build", cfg, "--json", "--jobs", "1")
        report = json.loads(out)
        assert code == 0
        kinds = {p.suffix for p in Path(report["folder"]).iterdir()} & {".ivf", ".vlad"}
        built.append((report["extracted"], kinds))
    assert built == [(5, {".ivf"}), (0, {".vlad"}), (0, {".ivf"})]
    monkeypatch.setenv("EXPMAP_RETRIEVAL_MEMORY_MB", "much")
    code, out, err = expmap("build", cfg)
    assert (code, out) == (2, "")
    assert (
        "EXPMAP_RETRIEVAL_MEMORY_MB: 'much' is not allowed (write a number of at least 0, for example 500)"
        in err
    )


def test_photos_that_cannot_be_used_are_reported_and_end_with_1(expmap, cfg):
    (cfg.parent / "photos" / "2.jpg").unlink()
    (cfg.parent / "photos" / "3.jpg").write_bytes(b"x")
    code, out, err = expmap("build", cfg, "--method", "vote", "--json")
    report = json.loads(out)
    assert code == 1
    assert [(i, photo) for i, photo, _ in report["failed"]] == [(2, "photos/2.jpg"), (3, "photos/3.jpg")]
    assert report["extracted"] == 3
    result = [line for line in err.splitlines() if "(id" in line]
    assert result[0].startswith("photos/2.jpg (id 2): file not found")
    assert result[1].startswith("photos/3.jpg (id 3): it is not an image")
    assert err.splitlines()[-1].startswith(
        "could not be used: 1 photo: file not found, such as photos/2.jpg; 1"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_photos_behind_a_link_are_refused_with_the_reason_that_the_check_gives(expmap, cfg, tmp_path):
    (cfg.parent / "photos").rename(tmp_path / "elsewhere")
    (cfg.parent / "photos").symlink_to(tmp_path / "elsewhere")
    reason = "is a link that points outside the map's folder"
    _, checked, _ = expmap("map", "check", cfg)
    assert f"'photos/0.jpg' {reason}" in checked
    _, _, err = expmap("build", cfg, "--method", "vote")
    assert err.splitlines()[-1] == f"could not be used: 5 photos: it {reason}, such as photos/0.jpg"
    code, _, err = expmap("evaluate", "--self", cfg, "--method", "vote")
    assert code == 3 and f"no photo of the map can be used; 5 photos: it {reason}" in err


def test_the_index_goes_where_it_is_asked(expmap, cfg, tmp_path):
    code, out, _ = expmap("build", cfg, "--method", "vote", "--index", tmp_path / "elsewhere", "--json")
    assert code == 0
    assert Path(json.loads(out)["folder"]).is_relative_to(tmp_path / "elsewhere")
    assert not (cfg.parent / "derived").exists()
    code, _, err = expmap(
        "localize",
        cfg,
        cfg.parent / "photos" / "1.jpg",
        "--method",
        "vote",
        "--index",
        tmp_path / "elsewhere",
    )
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--matcher", "hamming"], "matcher hamming cannot compare the float descriptors of sift"),
        (["--method", "vote", "--matcher", "ivf"], "does not work with method vote"),
        (["--extractor", "orb-wta4", "--matcher", "hamming"], "consist of pairs of bits"),
        (["--detector", "brief"], "unknown detector 'brief'"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_computed(expmap, cfg, options, says):
    code, out, err = expmap("build", cfg, *options)
    assert (code, out) == (2, "")
    assert says in err
    assert "work: " in err or "known: " in err
    assert err.count("\n") == 1
    assert not (cfg.parent / "derived").exists()


def test_what_only_questions_have_is_refused(expmap, cfg):
    code, out, err = expmap("build", cfg, "--fov", "60")
    assert (code, out) == (2, "")
    assert "--fov" in err
    assert not (cfg.parent / "derived").exists()


def test_a_broken_map_ends_with_3(expmap, cfg):
    cfg.write_text("plan.png;600;200\n0;photos/0.jpg;1,5;2\n")
    code, out, err = expmap("build", cfg)
    assert (code, out) == (3, "")
    assert f"{cfg}:2:" in err


def test_one_photo_is_a_map(expmap, make_map, tmp_path):
    cfg = make_map(tmp_path / "one", 1)
    assert expmap("build", cfg)[0] == 0
    code, out, _ = expmap("localize", cfg, cfg.parent / "photos" / "0.jpg", "--json")
    assert code == 0
    assert json.loads(out)[0]["hypotheses"][0]["experiences"] == [0]
