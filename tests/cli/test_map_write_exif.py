"""`expmap map write-exif` for people and scripts."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image

from webapp.app.main import root
from webapp.core.geo.georeference import Georeference
from webapp.files.maps.folder import read_map, write_map
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits

TURNED = Georeference("EPSG:4326", (1e-5, 2e-6, 26.5, 2e-6, -1e-5, 60.4, 0, 0, 1), "affine")


@pytest.fixture
def cfg(tmp_path: Path) -> Path:
    """A georeferenced map file with one photo next to it."""
    Image.new("RGB", (40, 30)).save(tmp_path / "s.png")
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg")
    path = tmp_path / "map.cfg"
    path.write_bytes(b"s.png;40;30\n0;a.jpg;20;20\n")
    write_map(path, replace(read_map(path), georeference=TURNED))
    return path


def test_photos_are_copied(cfg: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(root, ["map", "write-exif", str(cfg), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("a.jpg  60.39")
    assert "1 of 1 photos copied" in result.stderr
    assert read_facts(out / "a.jpg", limits=PhotoLimits()).gps


def test_a_second_run_replaces_nothing_and_fails(cfg: Path, tmp_path: Path) -> None:
    words = ["map", "write-exif", str(cfg), "-o", str(tmp_path / "out"), "--json"]
    first, second = CliRunner().invoke(root, words), CliRunner().invoke(root, words)
    assert json.loads(first.stdout)["photos"][0]["written"] is True
    assert second.exit_code == 1
    (photo,) = json.loads(second.stdout)["photos"]
    assert (photo["written"], photo["lat"]) == (False, None)
    assert "already" in photo["reason"]


def test_photos_are_changed_in_place_and_kept(cfg: Path) -> None:
    before = (cfg.parent / "a.jpg").read_bytes()
    result = CliRunner().invoke(root, ["map", "write-exif", str(cfg), "--in-place"])
    assert (result.exit_code, "1 of 1 photos written in place" in result.stderr) == (0, True)
    assert read_facts(cfg.parent / "a.jpg", limits=PhotoLimits()).gps
    assert (cfg.parent / "a.jpg_original").read_bytes() == before


def test_one_of_copies_and_in_place_is_asked_for(cfg: Path, tmp_path: Path) -> None:
    for words in ([], ["--in-place", "-o", str(tmp_path / "out")]):
        result = CliRunner().invoke(root, ["map", "write-exif", str(cfg), *words])
        assert result.exit_code == 2
        assert "either" in result.stderr
